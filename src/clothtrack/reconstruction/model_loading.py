"""Loads the network that reconstructs a garment: the token network, or the published one."""

from pathlib import Path

from clothtrack.errors import InvalidResultError
from clothtrack.reconstruction.availability import shipped_weights
from clothtrack.reconstruction.model import MeshReconstructor
from clothtrack.reconstruction.tokens.token_learning import KIND
from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor
from clothtrack.reconstruction.training.checkpoint import load_weights
from clothtrack.reconstruction.two_stages import network_of


def load_model(
    kind: str, path: Path | None = None, *, device: str = "cpu"
) -> MeshReconstructor | TokenReconstructor:
    """The network for a kind of garment.

    Args:
        kind: "towel", "tshirt" or, of the token network alone, "trousers".
        path: weights of the token network, or of both stages of the published one; those that come
            with the package when None.
        device: where to compute.

    Raises:
        InvalidResultError: there are no such weights, or they are damaged or for another garment.
    """
    if path is None:
        path = shipped_weights(kind)
        if path is None:
            raise InvalidResultError(
                f"no weights for {kind!r} come with this installation; train some with "
                "clothtrack pretrain, and name them with --weights"
            )
    weights = load_weights(path)
    if weights.kind == KIND:
        return TokenReconstructor.of(weights, device=device)
    if weights.kind != kind:
        raise InvalidResultError(
            f"{path} is for {weights.kind!r:.80}, the picture shows {kind!r}; give other "
            "weights, or say what it is with --garment"
        )
    model = MeshReconstructor(network_of(weights), kind)
    weights.load_into(model)
    return model.to(device).eval()
