"""Work over threads: never more than allowed, nothing lost, an idle thread takes work of another chain."""

import threading
import time

import pytest

from semlive.kernels import threads


class Watched:
    """Counts how many are at work at the same time, and who."""

    def __init__(self, workers=1):
        self.workers = workers
        self.lock = threading.Lock()
        self.now = 0
        self.most = 0
        self.done = []
        self.who = set()

    def __call__(self, first, last):
        with self.lock:
            self.now += 1
            self.most = max(self.most, self.now)
        time.sleep(0.003)
        # Others get some time to come; a busy computer begins a thread late.
        end_s = time.monotonic() + 0.2
        while self.most < self.workers and time.monotonic() < end_s:
            time.sleep(0.001)
        with self.lock:
            self.now -= 1
            self.done.append((first, last))
            self.who.add(threading.get_ident())


@pytest.fixture(params=[1, 2, 3])
def allowed(request, monkeypatch):
    monkeypatch.setattr(threads, "thread_count", lambda: request.param)
    return request.param


def test_every_piece_is_done_once_by_as_many_as_are_allowed(allowed):
    work = Watched(allowed)
    threads.parallel_chunks(work, 23, 2)
    assert sorted(work.done) == [(k, min(k + 2, 23)) for k in range(0, 23, 2)]
    assert work.most == allowed


def test_two_chains_at_once_keep_to_what_is_allowed(allowed):
    work = Watched(allowed)
    threads.run_pair_in_parallel(lambda: threads.parallel_chunks(work, 20, 1), lambda: threads.parallel_chunks(work, 20, 1))
    assert len(work.done) == 40
    assert work.most == allowed


def test_a_thread_that_has_finished_one_chain_continues_with_the_other(monkeypatch):
    monkeypatch.setattr(threads, "thread_count", lambda: 2)
    work = Watched(2)
    assert threads.run_pair_in_parallel(lambda: threads.parallel_chunks(work, 30, 1), lambda: time.sleep(0.01) or "short") == (
        None,
        "short",
    )
    assert work.most == 2
    assert len(work.who) == 2


def test_nothing_to_do_is_done(allowed):
    threads.parallel_chunks(Watched(), 0, 4)


def test_an_error_in_a_thread_is_not_lost(allowed):
    def work(first, last):
        if first == 6:
            raise ArithmeticError("row 6")

    with pytest.raises(ArithmeticError, match="row 6"):
        threads.parallel_chunks(work, 20, 2)
    for item, other in ((lambda: 1, lambda: work(6, 8)), (lambda: work(6, 8), lambda: 1)):
        with pytest.raises(ArithmeticError, match="row 6"):
            threads.run_pair_in_parallel(item, other)
    fine = Watched(allowed)
    threads.parallel_chunks(fine, 20, 1)
    assert fine.most == allowed  # those that failed have given their place back


def test_a_thread_that_ends_before_it_runs_a_line_is_not_waited_for(allowed, monkeypatch):
    """As where memory is refused; whoever called does its work."""
    before = len(threads._helping)
    monkeypatch.setattr(threads._thread, "start_new_thread", lambda _run, _arguments: 1)
    work = Watched()
    threads.parallel_chunks(work, 20, 1)
    assert sorted(work.done) == [(k, k + 1) for k in range(20)]
    assert work.most == 1
    assert threads.run_pair_in_parallel(lambda: "one", lambda: "other") == ("one", "other")
    with pytest.raises(ArithmeticError, match="mine"):
        threads.run_pair_in_parallel(lambda: 1, lambda: (_ for _ in ()).throw(ArithmeticError("mine")))
    assert len(threads._helping) == before
