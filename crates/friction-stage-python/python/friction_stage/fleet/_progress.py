"""Progress on stderr: a bar of at most 60 columns on a terminal, else a line every five seconds."""

from __future__ import annotations

import sys
import time

WIDTH = 60
"""Columns of the bar with its text."""
PERIOD = 5.0
"""Between two lines where there is no terminal, s."""


class ProgressLine:
    """Call it with a line and the share that is done."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._begin = time.monotonic()
        self._share_at_begin: float | None = None
        self._last_line = ""
        self._last_time = -PERIOD

    def __call__(self, what: str, share: float) -> None:
        now = time.monotonic()
        if self._share_at_begin is None:
            self._share_at_begin = share
        text = what + self._left(share, now)
        if self._terminal:
            room = WIDTH - len(text) - 3
            filled = round(share * room)
            bar = f"[{'#' * filled}{'.' * (room - filled)}] " if room > 4 else ""
            line = (bar + text)[:WIDTH]
            if line != self._last_line:
                print(f"\r{line:<{len(self._last_line)}}", end="", file=sys.stderr, flush=True)
                self._last_line = line
        elif now - self._last_time >= PERIOD:
            print(f"fleet: {text}", file=sys.stderr, flush=True)
            self._last_time = now

    def _left(self, share: float, now: float) -> str:
        """Time that is left, from what this run did."""
        before = self._share_at_begin or 0.0
        if share - before <= 0.0 or share >= 1.0:
            return ""
        left = (now - self._begin) * (1.0 - share) / (share - before)
        return f", {left:.0f} s left" if left < 120.0 else f", {left / 60.0:.0f} min left"

    def end(self) -> None:
        """Leaves the terminal free for what comes."""
        if self._terminal and self._last_line:
            print(f"\r{'':<{len(self._last_line)}}\r", end="", file=sys.stderr, flush=True)
            self._last_line = ""
