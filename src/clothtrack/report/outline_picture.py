"""Drawing of a garment's outline on its picture, with seams, openings and their lengths."""

import cv2
import numpy as np
from jaxtyping import UInt8

from clothtrack.garments.flat_template import FlatTemplate
from clothtrack.report.palette import (
    HIDDEN,
    INK,
    OUTSIDE,
    PAPER,
    PICKER_CLOSED,
    caption,
    rgb255,
    text_width,
    write,
)

Picture = UInt8[np.ndarray, "_ _ 3"]

WIDTH_PX = 1200
"""Width of the drawing [pixels]."""


def outline_picture(template: FlatTemplate, shown: Picture) -> UInt8[np.ndarray, "rows columns 3"]:
    """Return the RGB picture with the outline: openings red, seams blue, a towel's edge violet."""
    scale = WIDTH_PX / shown.shape[1]
    size = (WIDTH_PX, round(shown.shape[0] * scale))
    image = cv2.resize(shown, size, interpolation=cv2.INTER_LINEAR)
    image = (0.7 * image + 0.3 * np.array(rgb255(PAPER))).astype(np.uint8)
    middle = np.concatenate([stretch.pixels for stretch in template.stretches]).mean(axis=0)
    for stretch in template.stretches:
        color = HIDDEN if stretch.name == "edge" else OUTSIDE if stretch.sewn else PICKER_CLOSED
        places = (stretch.pixels + 0.5) * scale
        line = np.rint(places * 16).astype(np.int32)
        cv2.polylines(image, [line], False, rgb255(color), 3, cv2.LINE_AA, shift=4)
        for end in np.rint(places[[0, -1]] * 16).astype(int).tolist():
            cv2.circle(image, tuple(end), 6 * 16, rgb255(INK), -1, cv2.LINE_AA, shift=4)
    for stretch in template.stretches:
        halfway = (stretch.pixels[len(stretch.pixels) // 2] + 0.5) * scale
        if len(stretch.pixels) == 2:
            halfway = (stretch.pixels.mean(axis=0) + 0.5) * scale
        out = halfway - (middle + 0.5) * scale
        out = out / max(float(np.linalg.norm(out)), 1e-6)
        _label(image, f"{stretch.name} {100 * stretch.length_m:.1f} cm", halfway + 34 * out)
    measures = template.measures
    words = (
        f"{template.kind}: {100 * measures['width_m']:.1f} x {100 * measures['length_m']:.1f} cm, "
        f"{1e4 * measures['area_m2']:.0f} cm2, {template.mesh.vertex_count} vertices"
    )
    legend = "edge violet" if template.kind == "towel" else "openings red, seams blue"
    return np.concatenate([image, caption(WIDTH_PX, words, legend, height=40)])


def _label(image: Picture, text: str, at: np.ndarray) -> None:
    """Write text on a plain background, kept inside the picture."""
    width = text_width(text, height_px=14.0) + 12
    column = int(np.clip(at[0] - width / 2, 0, max(image.shape[1] - width, 0)))
    row = int(np.clip(at[1] + 6, 24, image.shape[0] - 8))
    cv2.rectangle(image, (column, row - 18), (column + width, row + 6), rgb255(PAPER), -1)
    write(image, text, (column + 6, row), height_px=14.0)
