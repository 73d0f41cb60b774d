"""Make a garment's template from a picture of it lying flat."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.files.atomic_write import write_file
from clothtrack.garments.flat_template import FlatTemplate, TemplateKind, make_template
from clothtrack.recordings.pictures import encode_png, read_header
from clothtrack.recordings.template_file import require_template_format, write_template


def garment_template(
    picture: Path | str,
    kind: TemplateKind,
    output: Path | str | None = None,
    *,
    vertex_count: int = 1000,
    metres_per_pixel: float | None = None,
    frame: int | None = None,
    front_neck_m: float | None = None,
    openings: Sequence[tuple[float, float]] = (),
    mirrored: bool = True,
    seed: int = 0,
    **of_picture: Any,
) -> FlatTemplate:
    """A garment's template mesh, from a picture of it lying flat with its front up.

    Args:
        picture: a recording in which it lies flat, a 16-bit depth PNG, or a colour or mask PNG
            taken from straight above.
        kind: what it is.
        output: file to write: .npz, or .obj with its canonical coordinates beside it; the outline
            over the picture is written beside it as OUTPUT.outline.png.
        vertex_count: about how many vertices.
        metres_per_pixel: of a colour or mask PNG, on the table.
        frame: of a recording; the first by default.
        front_neck_m: how deep the front's neck is cut [m], a tenth of the length by default; the
            picture shows the back's.
        openings: pixels (column, row) of both ends of hem, cuff, neck, cuff, or of waist, cuff,
            cuff, in their order around the garment; looked for by default.
        mirrored: make halves that are nearly mirror images so.
        seed: of the triangulation.
        **of_picture: `mask` (file) of a PNG and, of a depth PNG, `focal` [pixels], `depth_unit_m`
            and `table_distance_m`.

    Returns:
        The template: its `mesh` [m], its `measures` and the named `stretches` of its outline.

    Raises:
        InvalidRecordingError: the picture cannot be read or does not show such a flat garment.
        InvalidConfigError: an option is wrong, or means nothing for such a picture.
    """
    from clothtrack.reconstruction.flat_picture import flat_color, flat_depth, flat_recording
    from clothtrack.report.outline_picture import outline_picture

    picture = Path(picture)
    if output is not None:
        require_template_format(Path(output))
    options = {name: value for name, value in of_picture.items() if value is not None}
    if picture.is_dir():
        _refuse(options | _named(metres_per_pixel=metres_per_pixel), f"{picture} is a recording")
        flat = flat_recording(picture, frame or 0)
    elif read_header(picture).bits == 16:
        _refuse(_named(frame=frame, metres_per_pixel=metres_per_pixel), f"{picture} has depth")
        flat = flat_depth(picture, **options)
    else:
        mask = options.pop("mask", None)
        _refuse(options | _named(frame=frame), f"{picture} has no depth")
        if metres_per_pixel is None:
            raise InvalidConfigError(
                f"{picture}: a picture without depth does not say how large the garment is; add "
                "--metres-per-pixel, a known length on the table over its pixels"
            )
        flat = flat_color(picture, metres_per_pixel, mask=mask)
    template = make_template(
        flat.outline,
        kind,
        vertex_count=vertex_count,
        front_neck_m=front_neck_m,
        openings=np.array(openings, dtype=np.float64).reshape(-1, 2) if len(openings) else None,
        mirrored=mirrored,
        seed=seed,
        name=flat.name,
    )
    if output is not None:
        write_template(template.mesh, Path(output))
        drawn = encode_png(outline_picture(template, flat.shown))
        write_file(outline_path(Path(output)), drawn)
    return template


def outline_path(output: Path) -> Path:
    """Where the outline over the picture is written, beside a template."""
    return output.with_suffix(".outline.png")


def _named(**options: object) -> dict[str, object]:
    return {name: value for name, value in options.items() if value is not None}


def _refuse(options: dict[str, object], why: str) -> None:
    """Refuse options that would mean nothing here, rather than leave them out silently."""
    if options:
        names = " and ".join(f"--{name.removesuffix('_m').replace('_', '-')}" for name in options)
        raise InvalidConfigError(f"{names}: {why}; leave it out")
