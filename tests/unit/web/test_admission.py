"""Who keeps a connection when there are too many."""

from __future__ import annotations

from functools import partial

from semlive.web.admission import Admission, Client, Stage, is_loopback


class Room:
    """An admission that notes whom it closed."""

    def __init__(self, most: int = 4, here: int = 4, each: int = 2) -> None:
        self.admission = Admission(most, here, each)
        self.closed: list[Client] = []

    def admit(self, host: str, port: int) -> Client:
        self.admission.admit((host, port), partial(self.closed.append, (host, port)))
        return host, port


def test_the_one_that_did_nothing_for_longest_gives_its_place() -> None:
    room = Room()
    first, second = room.admit("127.0.0.1", 1), room.admit("127.0.0.1", 2)
    for port in (3, 4):
        room.admit("127.0.0.1", port)
    room.admission.enter(first, Stage.ORDINARY)
    room.admit("127.0.0.1", 5)
    assert room.closed == [second]
    assert len(room.admission) == 4


def test_a_request_with_the_token_is_never_closed_for_another() -> None:
    room = Room()
    steering = room.admit("127.0.0.1", 1)
    room.admission.enter(steering, Stage.AUTHENTICATED)
    for port in range(2, 50):
        room.admit("127.0.0.1", port)
    assert steering not in room.closed
    assert len(room.admission) == 4
    room.admission.enter(steering, Stage.ORDINARY)
    for port in range(50, 60):
        room.admit("127.0.0.1", port)
    assert steering in room.closed


def test_viewers_are_closed_after_all_others() -> None:
    room = Room()
    viewer, other = room.admit("127.0.0.1", 1), room.admit("127.0.0.1", 2)
    room.admission.enter(viewer, Stage.VIEWING)
    for port in (3, 4, 5):
        room.admit("127.0.0.1", port)
    assert room.closed == [other]


def test_an_address_has_a_share_of_its_own() -> None:
    room = Room()
    here = room.admit("127.0.0.1", 1)
    for port in range(2, 20):
        room.admit("192.0.2.7", port)
    assert here not in room.closed
    assert room.closed == [("192.0.2.7", port) for port in range(2, 18)]


def test_a_connection_that_is_lost_gives_its_place_back_once() -> None:
    room = Room()
    closes = [partial(room.closed.append, ("127.0.0.1", 1)) for _ in range(2)]
    for close in closes:
        room.admission.admit(("127.0.0.1", 1), close)
    room.admission.leave(("127.0.0.1", 1), closes[0])
    assert len(room.admission) == 1
    room.admission.leave(("127.0.0.1", 1), closes[1])
    room.admission.leave(("127.0.0.1", 1), closes[1])
    room.admission.enter(("127.0.0.1", 1), Stage.VIEWING)
    assert len(room.admission) == 0


def test_addresses_of_this_computer_are_recognised() -> None:
    assert [is_loopback(host) for host in ("127.0.0.1", "127.3.2.1", "::1", "::ffff:127.0.0.1")] == [True] * 4
    assert [is_loopback(host) for host in ("192.0.2.7", "::ffff:192.0.2.7", "fe80::1%eth0", "somebody")] == [False] * 4
