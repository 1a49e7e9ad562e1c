"""A proxy of TCP connections, in a thread."""

import asyncio
import contextlib
import threading

from tests.endpoints import free_port


class Forwarder:
    """Passes the bytes of each connection to its `port` on to the port `target`, and back.

    Attributes:
        opened: number of connections to `target` so far.
    """

    def __init__(self, target: int) -> None:
        self.port, self.target, self.opened = free_port(), target, 0
        self._loop, self._listens = asyncio.new_event_loop(), threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        self._listens.wait()

    def _run(self) -> None:
        with contextlib.suppress(asyncio.CancelledError, RuntimeError):
            self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._accept, "127.0.0.1", self.port, backlog=1024)
        self._listens.set()
        await server.serve_forever()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            await self.connect(reader, writer)

    async def connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, to = await asyncio.open_connection("127.0.0.1", self.target)
        self.opened += 1
        await asyncio.gather(passed(reader, to), passed(there, writer))

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()


async def passed(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            writer.write(data)
    writer.close()
