"""Size of the pictures while a camera moves: as large as fluent motion allows."""

from __future__ import annotations

TARGET_SECONDS = 1 / 24  # per picture
SMALLEST = 0.25  # of the full size
LARGEST_STEP = 1.5  # by which the size changes from one picture to the next
MIN_SIDE = 16  # px


class Pace:
    """Scale of the pictures of a moving camera, from the times that earlier ones took."""

    def __init__(self) -> None:
        self.scale = 0.5

    def coarse(self, width: int, height: int) -> tuple[int, int]:
        """Size in px of the next picture in motion, whose full size is width × height."""
        return max(MIN_SIDE, round(width * self.scale)), max(MIN_SIDE, round(height * self.scale))

    def took(self, seconds: float) -> None:
        """Learn from the time of a picture in motion.

        >>> pace = Pace()
        >>> pace.took(4 * TARGET_SECONDS)
        >>> round(pace.scale, 3)
        0.333
        """
        change = (TARGET_SECONDS / max(seconds, 1e-6)) ** 0.5  # time grows with the number of pixels
        self.scale = min(1.0, max(SMALLEST, self.scale * min(LARGEST_STEP, max(1 / LARGEST_STEP, change))))
