"""How long a unit of depth is, in what order its bytes stand, and whether the pictures agree."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Shaped, UInt16

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack.recordings.recording import FARTHEST_MEDIAN_M, NEAREST_MEDIAN_M

# Floats are stored in tenths of a millimeter, finer than any sensor and up to 6.5 m.
_FLOAT_STORED_M = 1e-4
_USUAL_M = (1e-3, 1.0, 1e-4, 2.5e-4, 2e-4, 1e-2)
_FARTHEST_FINE_M = 6.0
_SAMPLES, _MOST_CHANGE = 8, 5.0
_NOTHING = 65535  # some cameras write this where they measured nothing
_SMOOTHER = 8.0  # with exchanged bytes, neighbors agree this many times better: a wrong byte order


@dataclass(frozen=True)
class DepthUnit:
    """The unit of a source's depth: meters per unit, and where that comes from in words.

    Floats are stored in tenths of a millimeter, or in millimeters where they are far; `swapped`
    numbers have their bytes exchanged; with holes, 65535 means that nothing was measured.
    """

    unit_m: float
    origin: str
    is_float: bool = False
    is_far: bool = False
    swapped: bool = False
    has_holes: bool = False

    @property
    def stored_m(self) -> float:
        """Meters per count of what is stored."""
        return _FLOAT_STORED_M * (10 if self.is_far else 1) if self.is_float else self.unit_m

    @property
    def copied(self) -> bool:
        """Whether a 16-bit PNG of the source holds the counts to store."""
        return not (self.is_float or self.swapped or self.has_holes)

    def counts(self, numbers: Shaped[np.ndarray, "rows columns"]) -> UInt16[np.ndarray, "_ _"]:
        """Return the numbers of a source as counts to store; 0 where nothing was measured."""
        if self.swapped:
            numbers = numbers.byteswap()
        if self.is_float != (numbers.dtype.kind == "f"):
            raise TruncatedError(f"depth of {numbers.dtype}, unlike the first pictures")
        if not self.is_float:
            return np.where(numbers == _NOTHING, 0, numbers) if self.has_holes else numbers
        with np.errstate(invalid="ignore", over="ignore"):
            meters = numbers.astype(np.float32) * np.float32(self.unit_m)
            counts = np.rint(meters / np.float32(self.stored_m))
            return np.where((counts > 0) & (counts <= 65535), counts, 0).astype(np.uint16)


def measured_unit(
    source: Path, unit: DepthUnit | None, pictures: Sequence[Callable[[], np.ndarray]], ask: str
) -> DepthUnit:
    """Return the unit that was told, if any, with what some pictures say; else refuse by `ask`."""
    told_m = unit and unit.unit_m
    places = np.unique(np.linspace(0, len(pictures) - 1, _SAMPLES).round()).astype(int).tolist()
    read = {place: sample for place in places if (sample := _sample(pictures[place])) is not None}
    is_float = any(sample.dtype.kind == "f" for sample in list(read.values())[:1])
    read = {place: one for place, one in read.items() if (one.dtype.kind == "f") == is_float}
    swapped = bool(read) and _looks_swapped(list(read.values())[:3], told_m or 1.0)
    if swapped:
        read = {place: sample.byteswap() for place, sample in read.items()}
    medians = {place: median for place, sample in read.items()
               if (median := _median([sample], told_m)) is not None}  # fmt: skip
    if not medians:
        if unit is None:
            raise InvalidRecordingError(f"{source}: {ask}")
        return replace(unit, is_float=is_float, swapped=swapped)
    median = float(np.median(list(medians.values())))
    likely = next((one for one in _USUAL_M if one != told_m and _is_plausible(median * one)), None)
    shown = f"the median depth of the pictures is {median:g} units"
    if unit is None:
        hint = "" if likely is None else f"; {shown}, {median * likely:.3f} m with {likely:g}"
        raise InvalidRecordingError(f"{source}: {ask}{hint}")
    if not _is_plausible(median * unit.unit_m):
        remedy = "record it again, or name other depth pictures"
        if likely is not None:
            remedy = f"give --depth-unit-m {likely:g}, which makes it {median * likely:.3f} m"
        raise InvalidRecordingError(
            f"{source}: {shown}, {median * unit.unit_m:.3g} m with a unit of {unit.unit_m:g} m "
            f"({unit.origin}), not {NEAREST_MEDIAN_M:g} to {FARTHEST_MEDIAN_M:g} m; {remedy}"
        )
    for (here, before), (there, after) in pairwise(medians.items()):
        if not 1 / _MOST_CHANGE < after / before < _MOST_CHANGE:
            raise InvalidRecordingError(
                f"{source}: the median depth is {before:g} units in picture {here} and {after:g} "
                f"in picture {there}, so the unit changed; cut the source there"
            )
    far = is_float and max(medians.values()) * unit.unit_m > _FARTHEST_FINE_M
    holes = not is_float and any((sample == _NOTHING).mean() > 0.01 for sample in read.values())
    return replace(unit, is_float=is_float, swapped=swapped, is_far=far, has_holes=holes)


def _sample(picture: Callable[[], np.ndarray]) -> np.ndarray | None:
    try:
        return picture()
    except TruncatedError:
        return None


def _median(samples: list[np.ndarray], unit_m: float | None = None) -> float | None:
    """Return the median of what was measured: of the plausible where they are a tenth."""
    values = np.concatenate([sample[np.isfinite(sample) & (sample > 0)] for sample in samples])
    if values.dtype == np.uint16:
        values = values[values != _NOTHING]
    if unit_m is not None:
        meters = values * unit_m
        plausible = values[(meters >= NEAREST_MEDIAN_M) & (meters <= FARTHEST_MEDIAN_M)]
        values = plausible if len(plausible) > 0.1 * len(values) else values
    return float(np.median(values)) if values.size else None


def _looks_swapped(samples: list[np.ndarray], unit_m: float) -> bool:
    swapped = [sample.byteswap() for sample in samples]
    if samples[0].dtype.kind == "f":
        here, there = _median(samples), _median(swapped)
        odd = here is None or not 1e-3 < here < 1e6
        return there is not None and _is_plausible(there * unit_m) and odd
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
