"""A Modbus TCP server with line faults."""

from __future__ import annotations

from pymodbus.pdu import ModbusPDU
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import SimDevice

from semlive_simulators.load_frame.line_faults import Line, LineChunk, LineFaultInjector, ReplyFault, corrupt_reply


class FaultyTcpHandler(ServerRequestHandler):
    """The connection of one client."""

    def __init__(self, owner: FaultyTcpServer) -> None:
        super().__init__(owner, owner.trace_packet, owner.trace_pdu, owner.trace_connect)
        self._line_faults = owner.line_faults
        self._request = b""
        self._mark = 0
        self._fault: ReplyFault | None = None

    @property
    def _is_exempt(self) -> bool:
        name = self.transport.get_extra_info("peername") if self.transport else None
        return name is not None and self._line_faults.is_exempt(name[1])

    def callback_data(self, data: bytes, addr: tuple | None = None) -> int:
        """Receive data, which are discarded while the device is silent."""
        if self._line_faults.is_silent(Line.TCP) and not self._is_exempt:
            return len(data)
        self._request = data
        return super().callback_data(data, addr)

    async def handle_request(self) -> None:
        """Execute one request; faults that it orders affect later replies only."""
        self._mark = self._line_faults.mark()
        await super().handle_request()

    def server_send(self, pdu: ModbusPDU, addr: tuple | None) -> None:
        """Answer a request, with the fault of its reply."""
        self._fault = None if self._is_exempt else self._line_faults.take(Line.TCP, self._mark)
        super().server_send(pdu, addr)

    def send(self, data: bytes, addr: tuple | None = None) -> None:
        """Send the reply, changed by its fault."""
        due_s = 0.0
        for chunk in corrupt_reply(Line.TCP, self._request, data, self._fault):
            due_s += chunk.wait_s
            if due_s > 0:
                self.loop.call_later(due_s, self._put, chunk)
            else:
                super().send(chunk.data, addr)

    def _put(self, chunk: LineChunk) -> None:
        if self.transport:
            super().send(chunk.data, None)


class FaultyTcpServer(ModbusTcpServer):
    """The server of a device, with line faults."""

    def __init__(self, device: SimDevice, address: tuple[str, int], line_faults: LineFaultInjector) -> None:
        super().__init__(device, address=address)
        self.line_faults = line_faults

    def callback_new_connection(self) -> FaultyTcpHandler:
        """Create the handler of a new client."""
        return FaultyTcpHandler(self)
