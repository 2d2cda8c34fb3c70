"""Lightning's manners, mended: a stop is a sentence, and advice is not given."""

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from warnings import catch_warnings, filterwarnings

from ninedtact.errors import NinedtactError


class TrainingStopped(NinedtactError):
    """Ctrl-C ended the training before its last epoch."""


@contextmanager
def stopped_politely(out: Path) -> Iterator[None]:
    """Ctrl-C as `TrainingStopped`: Lightning itself would end the whole program, deaf to further signals."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    except (SystemExit, KeyboardInterrupt):
        raise TrainingStopped(
            f"stopped by Ctrl-C; what was learnt up to the last whole epoch is kept in {out}; run the command again to go on"
        ) from None
    finally:
        if signal.getsignal(signal.SIGINT) is not before:
            signal.signal(signal.SIGINT, before)


@contextmanager
def quiet() -> Iterator[None]:
    """Without Lightning's advice."""
    names = ("lightning.pytorch", "lightning.fabric")
    before = [logging.getLogger(name).level for name in names]
    for name in names:
        logging.getLogger(name).setLevel(logging.ERROR)
    try:
        with catch_warnings():
            filterwarnings("ignore", module="lightning")
            yield
    finally:
        for name, level in zip(names, before, strict=True):
            logging.getLogger(name).setLevel(level)
