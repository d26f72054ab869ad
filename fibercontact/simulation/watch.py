"""Where the time of a step goes."""

import time

__all__ = ["PARTS", "Watch"]

PARTS = ("rods", "detection", "assembly", "condensation", "solve")
"""What a step consists of: the rods' own systems and motion; contacts; H and w, first guess; W and b; impulses."""


class Watch:
    """Seconds spent in each part, by laps."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self._last = time.perf_counter()

    def lap(self, part: str) -> None:
        """Give the time since the last lap to a part."""
        now = time.perf_counter()
        self.seconds[part] += now - self._last
        self._last = now
