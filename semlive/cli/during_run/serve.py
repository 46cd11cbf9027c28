"""`semlive serve`: show a finished or growing log on the live page, without control of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.shared.live_page import PORT, Host, Name, PageAddress, PageProcess, Port
from semlive.errors import SemliveError
from semlive.inputs.printable import printable
from semlive.service.log.files import segments


def serve(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments; it may still grow.")],
    host: Host = "127.0.0.1",
    port: Port = PORT,
    name: Name = None,
) -> None:
    """Show a log on the live page until Ctrl-C; the page cannot control a run."""
    segments(log)
    console = Console(stderr=True)

    def ready(address: str | None, reason: str) -> None:
        if address is not None:
            console.print(f"live page: {address}", highlight=False, soft_wrap=True)
        else:
            console.print(printable(reason), highlight=False, markup=False, soft_wrap=True)

    page = PageProcess(log, PageAddress(host, port, tuple(name or ())), ready)
    try:
        code = page.wait()
    except KeyboardInterrupt:
        page.close()
        return
    raise SemliveError(f"the page ended with exit code {code}; check whether {host} is an address of this computer")
