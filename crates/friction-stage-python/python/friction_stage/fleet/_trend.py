"""What a parameter does over the recordings of a machine: its level, its slope, its outliers.

All robust, since a fleet has bad recordings: medians, the slope of Theil and Sen, and the modified
z-score.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

OUTLIER = 3.5
"""Modified z-score from which on a value is an outlier (Iglewicz and Hoaglin, How to Detect and
Handle Outliers, 1993)."""
MAD_OF_NORMAL = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
TWO_SIDED_95 = 1.959964
"""Of a normal distribution."""
FEWEST = 5
"""Values from which on one of them can be an outlier, and a slope has an interval. Assumed."""
MOST = 2000
"""Values of which a slope is made, evenly chosen: it takes the square of them."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Trend:
    """A parameter over the recordings of a machine.

    Attributes:
        level: Median.
        scatter: Around the line, as a standard deviation.
        slope: Per second, or per recording where they have no time; ``None`` where it has no
            meaning.
        slope_ci95: Its 95 % interval; ``None`` where there are too few.
        outliers: Indices of the values that do not belong to the others.
    """

    level: float
    scatter: float
    slope: float | None
    slope_ci95: tuple[float, float] | None
    outliers: tuple[int, ...]

    @property
    def moves(self) -> bool:
        """Whether the interval of the slope leaves zero out."""
        ci95 = self.slope_ci95
        return ci95 is not None and (ci95[0] > 0.0 or ci95[1] < 0.0)


def trend(times: Floats, values: Floats, sigmas: Floats) -> Trend:
    """The trend of values with their standard deviations (``nan``: unknown)."""
    level = float(np.median(values))
    slope, ci95 = _slope(times, values)
    line = level + (slope or 0.0) * (times - np.median(times))
    residuals = values - line
    residuals = residuals - np.median(residuals)
    scatter = MAD_OF_NORMAL * float(np.median(np.abs(residuals)))
    return Trend(level, scatter, slope, ci95, outliers(residuals, scatter, sigmas))


def outliers(residuals: Floats, scatter: float, sigmas: Floats) -> tuple[int, ...]:
    """Which residuals are too large for the scatter of all and for their own uncertainty."""
    if len(residuals) < FEWEST:
        return ()
    own = np.where(np.isfinite(sigmas), sigmas, 0.0)
    allowed = OUTLIER * np.hypot(scatter, own)
    # Equal values have no scatter; then what differs by rounding is none.
    allowed = np.maximum(allowed, 1e-9 * np.abs(residuals).max(initial=0.0))
    return tuple(int(i) for i in np.flatnonzero(np.abs(residuals) > allowed))


def _slope(times: Floats, values: Floats) -> tuple[float | None, tuple[float, float] | None]:
    """Median of the slopes of all pairs, with the interval of Sen (JASA 63, 1968)."""
    if len(times) > MOST:
        chosen = np.linspace(0, len(times) - 1, MOST).astype(int)
        times, values = times[chosen], values[chosen]
    first, second = np.triu_indices(len(times), 1)
    apart = times[second] - times[first]
    pairs = apart != 0.0
    if not pairs.any():
        return None, None
    slopes = np.sort((values[second] - values[first])[pairs] / apart[pairs])
    median = float(np.median(slopes))
    count = len(times)
    if count < FEWEST:
        return median, None
    # The statistic of Kendall, a whole number, is within this in 95 of 100 cases without a trend.
    width = int(TWO_SIDED_95 * np.sqrt(count * (count - 1) * (2 * count + 5) / 18.0))
    low = (len(slopes) - width) // 2 - 1
    high = (len(slopes) + width + 1) // 2
    if low < 0 or high >= len(slopes):
        return median, None
    return median, (float(slopes[low]), float(slopes[high]))
