"""The parameters of an action in words: unit, relation to the default, what a larger one does."""

from collections.abc import Mapping
from dataclasses import asdict
from html import escape

from clothtrack.tracking.configuration import RunConfig

MEANINGS: Mapping[str, tuple[str, str]] = {
    "stretch_compliance": ("m/N", "How far an edge gives to a pull; 0: it does not stretch."),
    "bend_compliance": ("m/N", "How far it gives to bending (at 8 mm spacing); larger: limper."),
    "table_friction": ("", "Coulomb coefficient of cloth on table; larger slides less."),
    "particle_friction": ("", "Coulomb coefficient of cloth on cloth; larger slides less."),
    "held_layers": ("layers", "How many layers the picker took; 0: whatever was nearest."),
    "grasp_offset_z_m": ("m", "Where the picker holds the cloth over its tip."),
}
"""Unit and explanation of each of `clothtrack.tracking.theta.PARAMETERS`."""


def parameter_head(name: str) -> str:
    """The name of a parameter with its unit, and what it means as a tooltip."""
    unit, meaning = MEANINGS.get(name, ("", ""))
    words = name.removesuffix("_m").replace("_", " ")
    return (
        f'<th title="{escape(meaning, quote=True)}">{escape(words)}'
        f"{f' [{escape(unit)}]' if unit else ''}</th>"
    )


def parameter_table(parameters: Mapping[str, float]) -> str:
    """Each parameter that was used, with its relation to the tracker's default."""
    defaults = {name: float(value) for name, value in asdict(RunConfig().cloth.theta()).items()}
    rows = "".join(
        f'<tr>{parameter_head(name)}<td title="{escape(MEANINGS.get(name, ("", ""))[1])}">'
        f'{value:.4g}</td><td class="note">{_compared(value, defaults.get(name))}</td></tr>'
        for name, value in parameters.items()
    )
    if not rows:
        return ""
    return (
        "<table><thead><tr><th>what was used</th><th></th><th>beside the default</th></tr></thead>"
        f"<tbody>{rows}</tbody></table>"
    )


def _compared(value: float, default: float | None) -> str:
    if default is None:
        return ""
    if value == default:
        return "the default"
    if not default:
        return "default 0"
    return f"{value / default:.3g} \N{MULTIPLICATION SIGN} the default {default:.4g}"
