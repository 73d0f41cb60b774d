"""How long a unit of depth is, in what order its bytes stand, and whether the pictures agree."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Shaped, UInt16

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack.recordings.recording import FARTHEST_MEDIAN_M, NEAREST_MEDIAN_M

# Floats are stored in tenths of a millimeter, finer than any sensor and up to 6.5 m.
_FLOAT_STORED_M = 1e-4
_USUAL_M = (1e-3, 1.0, 1e-4, 2.5e-4, 2e-4, 1e-2)
_SAMPLES = 3
# Neighbors that agree this many times better with exchanged bytes tell a wrong byte order.
_SMOOTHER = 8.0


@dataclass(frozen=True)
class DepthUnit:
    """The unit of a source's depth: meters per unit, and where that comes from in words.

    Floats are stored in tenths of a millimeter; `swapped` numbers have their bytes exchanged.
    """

    unit_m: float
    origin: str
    is_float: bool = False
    swapped: bool = False

    @property
    def stored_m(self) -> float:
        """Meters per count of what is stored."""
        return _FLOAT_STORED_M if self.is_float else self.unit_m

    @property
    def copied(self) -> bool:
        """Whether a 16-bit PNG of the source holds the counts to store."""
        return not (self.is_float or self.swapped)

    def counts(self, numbers: Shaped[np.ndarray, "rows columns"]) -> UInt16[np.ndarray, "_ _"]:
        """Return the numbers of a source as counts to store; 0 where nothing was measured."""
        if self.swapped:
            numbers = numbers.byteswap()
        if self.is_float != (numbers.dtype.kind == "f"):
            raise TruncatedError(f"depth of {numbers.dtype}, unlike the first pictures")
        if not self.is_float:
            return numbers
        with np.errstate(invalid="ignore", over="ignore"):
            meters = numbers.astype(np.float32) * np.float32(self.unit_m)
            counts = np.rint(meters / np.float32(self.stored_m))
            return np.where((counts > 0) & (counts <= 65535), counts, 0).astype(np.uint16)


def measured_unit(
    source: Path, unit: DepthUnit | None, pictures: Iterable[Callable[[], np.ndarray]], ask: str
) -> DepthUnit:
    """Return the unit with what the first pictures say of it.

    Args:
        source: path of the source, for messages.
        unit: the unit as the source or the user tells it; None if nobody does.
        pictures: functions that decode the depth pictures.
        ask: message where nobody tells the unit.
    """
    samples = list(islice(_samples(pictures), _SAMPLES))
    is_float = bool(samples) and samples[0].dtype.kind == "f"
    samples = [sample for sample in samples if (sample.dtype.kind == "f") == is_float]
    swapped = bool(samples) and _looks_swapped(samples, 1.0 if unit is None else unit.unit_m)
    if swapped:
        samples = [sample.byteswap() for sample in samples]
    median = _median(samples)
    if unit is None:
        likely = None if median is None else _likely_m(median, None)
        if median is not None and likely is not None:
            ask += f"; their median is {median:g} units, {median * likely:.3f} m with {likely:g}"
        raise InvalidRecordingError(f"{source}: {ask}")
    if median is not None and not _is_plausible(median * unit.unit_m):
        likely = _likely_m(median, unit.unit_m)
        remedy = "record it again, or name other depth pictures"
        if likely is not None:
            remedy = f"give --depth-unit-m {likely:g}, which makes it {median * likely:.3f} m"
        raise InvalidRecordingError(
            f"{source}: the median depth of the first pictures is {median:g} units, "
            f"{median * unit.unit_m:.3g} m with a unit of {unit.unit_m:g} m ({unit.origin}); "
            f"plausible is {NEAREST_MEDIAN_M:g} to {FARTHEST_MEDIAN_M:g} m; {remedy}"
        )
    return replace(unit, is_float=is_float, swapped=swapped)


def _samples(pictures: Iterable[Callable[[], np.ndarray]]) -> Iterator[np.ndarray]:
    for picture in pictures:
        try:
            yield picture()
        except TruncatedError:
            continue


def _median(samples: list[np.ndarray]) -> float | None:
    valid = [sample[np.isfinite(sample) & (sample > 0)] for sample in samples]
    valid = [values for values in valid if values.size]
    return float(np.median(np.concatenate(valid))) if valid else None


def _looks_swapped(samples: list[np.ndarray], unit_m: float) -> bool:
    swapped = [sample.byteswap() for sample in samples]
    if samples[0].dtype.kind == "f":
        here, there = _median(samples), _median(swapped)
        return (
            there is not None
            and _is_plausible(there * unit_m)
            and (here is None or not 1e-3 < here < 1e6)
        )
    return _roughness(swapped) * _SMOOTHER < _roughness(samples)


def _roughness(samples: list[np.ndarray]) -> float:
    """Return the mean difference of neighbors that were both measured."""
    total = count = 0.0
    for sample in samples:
        left, right = sample[:, :-1].astype(np.int64), sample[:, 1:].astype(np.int64)
        both = (left > 0) & (right > 0)
        total += float(np.abs(left - right)[both].sum())
        count += float(both.sum())
    return total / count if count else 0.0


def _is_plausible(median_m: float) -> bool:
    return NEAREST_MEDIAN_M <= median_m <= FARTHEST_MEDIAN_M


def _likely_m(median: float, given_m: float | None) -> float | None:
    return next(
        (unit for unit in _USUAL_M if unit != given_m and _is_plausible(median * unit)), None
    )
