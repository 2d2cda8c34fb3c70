"""The log of a server in the terminal: a line for each event and no traceback, and not more lines than a person can read."""

import logging
from collections import deque
from pathlib import Path
from traceback import extract_tb

_LINES_PER_MINUTE = 20
"""Most lines that a server logs per minute."""
_CHARACTERS_PER_LINE = 400


def one_line_logger() -> logging.Logger:
    """Return the logger of one server."""
    logger, recent = logging.Logger(f"{__name__}.server"), deque[float](maxlen=_LINES_PER_MINUTE)
    logger.parent = logging.getLogger(__name__)

    def is_worth_a_line(record: logging.LogRecord) -> bool:
        if record.levelno < logging.WARNING or record.msg == "opening handshake failed":
            return False  # browsers open connections in advance and drop them
        if record.exc_info and (failure := record.exc_info[1]) is not None:
            place = extract_tb(failure.__traceback__)[-1:]
            where = "".join(f" at {Path(each.filename).name}:{each.lineno}" for each in place)
            said = " ".join(repr(failure).split())[:_CHARACTERS_PER_LINE]
            record.msg, record.args = f"{record.getMessage()}: {said}{where}", None
            record.exc_info = record.exc_text = None
        if len(recent) == _LINES_PER_MINUTE and record.created - recent[0] < 60:
            return False
        recent.append(record.created)
        return True

    logger.addFilter(is_worth_a_line)
    return logger
