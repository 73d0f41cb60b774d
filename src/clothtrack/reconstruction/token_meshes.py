"""Meshes from pictures by the token network: its rival answers, and the search among them."""

from dataclasses import replace
from functools import partial

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.cuts import KnownGarment, sized
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.from_picture import Method, NetworkMesh, Reconstruction
from clothtrack.reconstruction.isometric_fit import EDGES, Guide, IsometricFit
from clothtrack.reconstruction.search import Search
from clothtrack.reconstruction.seen_cloth import SeenCloth
from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor
from clothtrack.reconstruction.training.checkpoint import Weights
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Table
from clothtrack.simulation.untangling import Untangler, Untangling

SEEN_MOBILITY = 0.3
"""Mobility of a visible vertex in the last untangling. It is low because visible vertices were
measured, while hidden ones were guessed."""

_LAST_ROUNDS = 30
"""Maximum rounds of a final untangling that moves visible vertices as freely as hidden ones."""


def finished(
    fit: IsometricFit,
    guide: Guide,
    cloth: SeenCloth,
    *,
    table: Table | None,
    opposite: bool = False,
    device: str = "cpu",
) -> Untangling:
    """Return the complete fit of a garment to a prediction and a picture.

    The garment is fitted, its layers are put in the order that the network predicts, and crossings
    are untangled. Untangling moves visible vertices, so the cloth is attracted to the picture once
    more, with layers in their current order, and the last crossings are untangled gently.
    """
    apart = Untangler(fit.rest, device=device)
    order_m = -guide.places[:, 2] if opposite else guide.places[:, 2]
    laid = fit.lay(guide, cloth, EDGES, order_m=order_m)
    laid = fit.layered(laid, order_m, cloth.table_m)
    first = apart(laid, table=table)
    drawn = fit.polished(first.positions, cloth, guide.size_m)
    drawn = fit.layered(drawn, drawn[:, 2], cloth.table_m, keep=1.0, votes=1)
    mobility = np.where(fit.visible(drawn, cloth), SEEN_MOBILITY, 1.0)
    last = apart(drawn, mobility=mobility, table=table)
    if last.crossings_after:
        last = apart(last.positions, table=table, rounds=_LAST_ROUNDS)
    return replace(last, crossings_before=first.crossings_before)


class TokenMeshes:
    """Meshes from pictures by the token network (`design.Reconstructor`).

    Attributes:
        states_error: True, because the network predicts the error of each vertex.

    Args:
        network: token network that answers for one garment in one picture.
    """

    states_error = True

    def __init__(self, network: TokenReconstructor) -> None:
        self.network = network

    @classmethod
    def load(cls, weights: Weights, kind: str, *, device: str = "cpu") -> "TokenMeshes":
        """Return the network of loaded weights."""
        del kind
        return cls(TokenReconstructor.of(weights, device=device))

    def mesh(
        self,
        picture: DepthInput,
        kind: str,
        *,
        method: Method = "template",
        size_m: tuple[float, float] | None = None,
        template: ClothMesh | None = None,
        vertex_count: int = 1000,
        refined: bool = False,
        untangle: bool = False,
        observation: Observation | None = None,
        device: str = "cpu",
    ) -> NetworkMesh:
        """Return the mesh whose answer explains the picture best.

        Arguments and errors are those of `design.Reconstructor.mesh`. The fit always uses the
        picture's own points, and a refined mesh is always untangled.
        """
        del untangle, observation
        if method != "template":
            raise InvalidConfigError(
                f"the token network makes no mesh by method {method!r}; take 'template', or name "
                "weights of the published network, which knows towels and T-shirts only"
            )
        search = Search(self.network, picture, device=device)
        if template is not None:
            best = search.known(KnownGarment.of(template, device=device))
        elif size_m is not None:
            best = search.known(sized(kind, size_m, vertex_count, device=device))
        else:
            best = search.best(kind, vertex_count=vertex_count)
        rest, answer, vertices, untangling = best.garment.mesh, best.answer, best.vertices, None
        finish = partial(
            finished, best.garment.fit, answer.guide, search.cloth, table=picture.table,
            device=device,
        )  # fmt: skip
        if refined:
            untangling = finish()
            vertices = untangling.positions
        mesh = rest.with_vertices(vertices)
        size = self.network.config.output_size
        canonical = np.full((size, size, 3), np.nan, np.float32)
        confidence = np.zeros((size, size), np.float32)
        rows, columns = answer.pixels.T
        canonical[rows, columns], confidence[rows, columns] = (
            answer.seen.canonical,
            answer.seen.confidence,
        )
        spread_m = answer.guide.spread_m
        return NetworkMesh(
            mesh,
            Reconstruction(
                mesh, "template", answer.view.camera, canonical, confidence, answer.seen, rest=rest
            ),
            expected_error_m=float(np.mean(spread_m)),
            spread_m=spread_m,
            spread_over_turns=search.spread_over_turns(best.garment, vertices),
            untangling=untangling,
            opposite=(lambda: finish(opposite=True).positions) if refined else None,
            choices=(best.choice, *(one for one in search.choices if one is not best.choice)),
        )
