"""A Modbus TCP server whose line can be in trouble."""

from __future__ import annotations

from pymodbus.pdu import ModbusPDU
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import SimDevice

from semlive_simulators.load_frame.line_faults import Line, LineChunk, LineFaultInjector, ReplyFault, corrupt_reply


class FaultyTcpHandler(ServerRequestHandler):
    """One client's connection."""

    def __init__(self, owner: FaultyTcpServer) -> None:
        super().__init__(owner, owner.trace_packet, owner.trace_pdu, owner.trace_connect)
        self._troubles = owner.troubles
        self._request = b""
        self._mark = 0
        self._spoiling: ReplyFault | None = None

    @property
    def _spared(self) -> bool:
        name = self.transport.get_extra_info("peername") if self.transport else None
        return name is not None and self._troubles.spares(name[1])

    def callback_data(self, data: bytes, addr: tuple | None = None) -> int:
        """What comes in; while the device is silent it is gone."""
        if self._troubles.is_silent(Line.TCP) and not self._spared:
            return len(data)
        self._request = data
        return super().callback_data(data, addr)

    async def handle_request(self) -> None:
        """Obey one request; orders that come with it spoil later replies only."""
        self._mark = self._troubles.mark()
        await super().handle_request()

    def server_send(self, pdu: ModbusPDU, addr: tuple | None) -> None:
        """Answer it."""
        self._spoiling = None if self._spared else self._troubles.take(Line.TCP, self._mark)
        super().server_send(pdu, addr)

    def send(self, data: bytes, addr: tuple | None = None) -> None:
        """Put the reply on the line, or what becomes of it."""
        due_s = 0.0
        for piece in corrupt_reply(Line.TCP, self._request, data, self._spoiling):
            due_s += piece.wait_s
            if due_s > 0:
                self.loop.call_later(due_s, self._put, piece)
            else:
                super().send(piece.data, addr)

    def _put(self, piece: LineChunk) -> None:
        if self.transport:
            super().send(piece.data, None)


class FaultyTcpServer(ModbusTcpServer):
    """The server of a device at an address."""

    def __init__(self, device: SimDevice, address: tuple[str, int], troubles: LineFaultInjector) -> None:
        super().__init__(device, address=address)
        self.troubles = troubles

    def callback_new_connection(self) -> FaultyTcpHandler:
        """Somebody connects."""
        return FaultyTcpHandler(self)
