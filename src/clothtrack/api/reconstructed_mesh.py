"""The mesh that `reconstruct` returns, with what is known of it."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothtrack.geometry.mesh import ClothMesh

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from clothtrack.evaluation.verdict import Verdict
    from clothtrack.reconstruction.agreement import Agreement
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.from_picture import NetworkMesh


@dataclass(frozen=True, eq=False, repr=False)
class ReconstructedMesh(ClothMesh):
    """A mesh from one picture, which can be used as any `ClothMesh`.

    Attributes:
        network: the result of the network.
        picture: the input picture, with its garment.
        given: what was given with the picture: "size", "template", "mask".
        path: where it was written; None if it was not.
    """

    network: "NetworkMesh" = None  # pyright: ignore[reportAssignmentType]
    picture: "DepthInput" = None  # pyright: ignore[reportAssignmentType]
    given: frozenset[str] = frozenset()
    path: Path | None = None

    @classmethod
    def of(
        cls, network: "NetworkMesh", picture: "DepthInput", given: frozenset[str]
    ) -> "ReconstructedMesh":
        """Return the mesh of a network's result, which must have one."""
        mesh = network.mesh
        assert mesh is not None
        return cls(
            mesh.vertices, mesh.faces, mesh.canonical, network=network, picture=picture,
            given=given,
        )  # fmt: skip

    @cached_property
    def figures(self) -> dict[str, Any]:
        """How well it fits the picture, and its expected error."""
        from clothtrack.reconstruction.from_picture import figures_of

        return figures_of(self.network, self, self.picture, self._agreement)

    @cached_property
    def verdict(self) -> "Verdict":
        """Trust, look or reject, with the evidence."""
        from clothtrack.evaluation.verdict import picture_verdict

        return picture_verdict(self.network, self._agreement, self.given)

    @property
    def vertex_bounds_m(self) -> "Float[np.ndarray, ' vertices'] | None":
        """Error that each vertex stays under in nine of ten cases [m].

        None for a network that does not predict its error.
        """
        return self.network.vertex_bounds_m

    @cached_property
    def _agreement(self) -> "Agreement":
        from clothtrack.reconstruction.agreement import agreement_of

        return agreement_of(self, self.picture)

    def text(self) -> str:
        """Return its path, how well it fits, the assumed size of the garment, and the verdict."""
        figures, network = self.figures, self.network
        summary = (
            f"{self.path or 'mesh'}   {self.vertex_count} vertices, "
            f"{1e3 * figures['cloud_to_mesh_m']:.1f} mm from the cloud"
        )
        if figures["expected_error_m"] is not None:
            summary += f", expected error {1e3 * figures['expected_error_m']:.0f} mm"
        if network.choices and not self.given & {"size", "template"}:
            width, length = network.choices[0].size_m
            # A towel's name is only that of the rectangle that the search began with.
            cut = "" if self.picture.kind == "towel" else f"{network.choices[0].cut} of "
            summary += f", taken for {cut}{width:.2f} x {length:.2f} m"
        if network.scale != 1.0:
            summary += f", seen as if {network.scale:g} times as large"
        lines = [summary, f"  {self.verdict}"]
        if self.verdict.remedy:
            lines.append(f"  what helps: {self.verdict.remedy}")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as JSON-compatible values."""
        return {
            "mesh": None if self.path is None else str(self.path),
            **self.figures,
            "verdict": self.verdict.as_dict(),
        }
