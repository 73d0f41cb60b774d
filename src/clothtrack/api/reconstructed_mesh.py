"""The mesh that `reconstruct` returns, with what is known of it."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothtrack.geometry.mesh import ClothMesh

if TYPE_CHECKING:
    from clothtrack.evaluation.verdict import Verdict
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.from_picture import NetworkMesh


@dataclass(frozen=True, eq=False, repr=False)
class ReconstructedMesh(ClothMesh):
    """A mesh from one picture. It is a `ClothMesh`: whatever takes one takes it.

    Attributes:
        network: how it came about.
        picture: what it was made from, with its garment.
        named: what messages call the picture.
        asked: whether the garment's size was given.
        path: where it was written; None when it was not.
    """

    network: "NetworkMesh" = None  # pyright: ignore[reportAssignmentType]
    picture: "DepthInput" = None  # pyright: ignore[reportAssignmentType]
    named: str = ""
    asked: bool = False
    path: Path | None = None

    @classmethod
    def of(
        cls, network: "NetworkMesh", picture: "DepthInput", *, named: str, asked: bool
    ) -> "ReconstructedMesh":
        """The mesh of a network's answer that has one."""
        mesh = network.mesh
        assert mesh is not None
        return cls(
            mesh.vertices, mesh.faces, mesh.canonical, network=network, picture=picture,
            named=named, asked=asked,
        )  # fmt: skip

    @cached_property
    def figures(self) -> dict[str, Any]:
        """How well it fits the picture, its expected error, and whether to trust it."""
        from clothtrack.reconstruction.from_picture import figures_of

        return figures_of(self.network, self, self.picture)

    @cached_property
    def verdict(self) -> "Verdict":
        """Trust, look or reject, by the limits of a tracked label."""
        from clothtrack.evaluation.verdict import reconstruction_verdict

        figures = self.figures
        return reconstruction_verdict(figures["why_not"], figures["expected_error_m"])

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why not to trust it; nothing where it can be trusted."""
        if self.verdict.word == "trust":
            return ()
        return (
            f"{self.named}: do not trust this mesh ({self.verdict}). Is the garment, its size, its "
            "mask or the depth's unit another?",
        )

    def text(self) -> str:
        """Return one line: where it is, how well it fits, and what it was taken for."""
        figures, network = self.figures, self.network
        summary = (
            f"{self.path or 'mesh'}   {self.vertex_count} vertices, "
            f"{1e3 * figures['cloud_to_mesh_m']:.1f} mm from the cloud"
        )
        if figures["expected_error_m"] is not None:
            summary += f", expected error {1e3 * figures['expected_error_m']:.0f} mm"
        if network.choices and not self.asked and self.picture.size_m is None:
            width, length = network.choices[0].size_m
            # The name of a towel is that of the rectangle that the search began with.
            cut = "" if self.picture.kind == "towel" else f"{network.choices[0].cut} of "
            summary += f", taken for {cut}{width:.2f} x {length:.2f} m"
        if network.scale != 1.0:
            summary += f", seen as if {network.scale:g} times as large"
        return summary

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as JSON holds them."""
        return {
            "mesh": None if self.path is None else str(self.path),
            **self.figures,
            "trusted": self.verdict.word == "trust",
            "verdict": self.verdict.as_dict(),
        }
