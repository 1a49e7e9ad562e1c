"""Log lines to the standard error in a thread of their own: a reader that hangs must not stop the event loop."""

import logging
import queue
import sys
from logging.handlers import QueueHandler, QueueListener

MOST_WAITING = 1_000  # lines; more are dropped


class DroppingHandler(QueueHandler):
    """Hands log records over, as far as there is room."""

    def enqueue(self, record: logging.LogRecord) -> None:
        """Hands one record over, or drops it."""
        try:
            self.queue.put_nowait(record)
        except queue.Full:
            return


def start_logging() -> QueueListener:
    """Begins to write log lines; `stop` of what is returned writes those that wait."""
    lines: queue.Queue[logging.LogRecord] = queue.Queue(MOST_WAITING)
    writing = logging.StreamHandler(sys.stderr)
    writing.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
    listener = QueueListener(lines, writing)
    listener.start()
    handing = DroppingHandler(lines)
    handing.setFormatter(logging.Formatter())
    logging.basicConfig(level=logging.INFO, handlers=[handing], force=True)
    for name in ("can", "canopen"):  # each SDO of simulated boards, for one
        logging.getLogger(name).setLevel(logging.WARNING)
    return listener
