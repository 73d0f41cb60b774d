"""The verb that makes a garment's template from a picture of it lying flat: garment."""

import re
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import complain, say_result
from clothtrack.errors import InvalidConfigError

_PLACE = re.compile(r"(-?\d+(?:\.\d+)?),(-?\d+(?:\.\d+)?)")


def garment(
    picture: Positional[Path],
    *,
    kind: Literal["towel", "tshirt", "polo", "sweater", "trousers"],
    output: Path,
    vertices: int = 1000,
    mask: Path | None = None,
    metres_per_pixel: float | None = None,
    depth_unit: float | None = None,
    focal: float | None = None,
    table_distance: float | None = None,
    frame: int | None = None,
    front_neck: float | None = None,
    openings: tuple[str, ...] = (),
    as_it_lies: bool = False,
    json: AsJson = False,
) -> int:
    """Make a garment's template mesh from a picture of it lying flat, its front up.

    Writes TEMPLATE.outline.png beside it: look at it before you use the template.

    Args:
        picture: a recording, a 16-bit depth PNG, or a colour or mask PNG from straight above.
        kind: what it is.
        output: template to write: .npz, or .obj with its canonical coordinates beside it.
        vertices: about how many.
        mask: picture of where the garment is, for a PNG.
        metres_per_pixel: on the table, for a colour or mask PNG.
        depth_unit: metres per unit of a depth PNG; 0.001 if not given.
        focal: focal length of a depth PNG's camera [pixels]; 0.94 of its width if not given.
        table_distance: from a depth PNG's camera to the table [m]; found if not given.
        frame: of a recording; the first by default.
        front_neck: how deep the front's neck is cut [m]; a tenth of the length if not given.
        openings: where they end, when the guess is wrong: COLUMN,ROW of both ends of hem, cuff,
            neck, cuff, or of waist, cuff, cuff, once around the garment.
        as_it_lies: leave both halves as they lie; otherwise they are made mirror images.
        json: machine-readable.
    """
    from clothtrack.front.garment import garment_template, outline_path

    places = []
    for text in openings:
        match = _PLACE.fullmatch(text)
        if match is None:
            raise InvalidConfigError(f"--openings has {text!r}; write pixels as COLUMN,ROW")
        places.append((float(match[1]), float(match[2])))
    template = garment_template(
        picture, kind, output, vertex_count=vertices, metres_per_pixel=metres_per_pixel,
        frame=frame, front_neck_m=front_neck, openings=places, mirrored=not as_it_lies,
        mask=mask, depth_unit_m=depth_unit, focal=focal, table_distance_m=table_distance,
    )  # fmt: skip
    drawn = outline_path(output)
    measures = template.measures
    report = {
        "template": str(output), "outline": str(drawn), "kind": kind,
        "vertices": template.mesh.vertex_count, "asymmetry_m": template.asymmetry_m,
        "mirrored": template.mirrored, "neck_seen": template.neck_seen, **measures,
    }  # fmt: skip
    lengths = ", ".join(
        f"{name.removesuffix('_m').replace('_', ' ')} {100 * value:.1f}"
        for name, value in measures.items()
        if name not in ("width_m", "length_m", "area_m2")
    )
    size = f"{100 * measures['width_m']:.1f} x {100 * measures['length_m']:.1f} cm"
    say_result(
        f"{output}   {kind} of {size}, {1e4 * measures['area_m2']:.0f} cm2, "
        f"{template.mesh.vertex_count} vertices\n{lengths} cm\n{drawn}   (look at it)",
        report,
        json=json,
    )
    if kind not in ("towel", "trousers") and not template.neck_seen:
        complain("the neck's ends are a guess: no dip shows them; check the picture, or --openings")
    if kind != "towel" and not (template.mirrored or as_it_lies):
        complain(
            f"the halves differ by {1e3 * template.asymmetry_m:.0f} mm and are left as they lie; "
            "check the openings in the picture, and lay the garment out more evenly"
        )
    return 0
