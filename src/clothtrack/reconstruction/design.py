"""The interface of reconstruction networks, and a description of each design that loads nothing.

The core has the token network. Other packages provide designs as entry points of
`clothtrack.networks` (`model_loading.designs`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    from clothtrack.geometry.mesh import ClothMesh
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.from_picture import Method, NetworkMesh
    from clothtrack.reconstruction.learning_outcome import LearningOutcome
    from clothtrack.reconstruction.training.checkpoint import Weights
    from clothtrack.recordings.point_cloud import Observation


@runtime_checkable
class Reconstructor(Protocol):
    """A trained network that makes meshes from pictures.

    Attributes:
        states_error: whether it predicts the error of each vertex.
    """

    states_error: bool

    def mesh(
        self,
        picture: "DepthInput",
        kind: str,
        *,
        method: "Method" = "template",
        size_m: tuple[float, float] | None = None,
        template: "ClothMesh | None" = None,
        vertex_count: int = 1000,
        refined: bool = False,
        untangle: bool = False,
        observation: "Observation | None" = None,
        device: str = "cpu",
    ) -> "NetworkMesh":
        """Return the full mesh of the cloth in a depth picture, hidden layers included.

        Args:
            picture: depth, mask, camera and table; world z up.
            kind: "towel", "tshirt" or "trousers", as far as the network knows them.
            method: "template" fits the garment's own mesh to the picture; "implicit" takes the
                surface of a predicted field and may find none.
            size_m: width and length of the garment when known [m]; else estimated from the picture.
            template: the flat garment itself, canonical coordinates filled; instead of `size_m`.
            vertex_count: approximate vertex count of a template that is made here.
            refined: fine-tune the mesh to the picture.
            untangle: remove self-intersections of the mesh, before it is fine-tuned and after.
            observation: observation that it is fine-tuned to; the picture's own points when None.
            device: compute device.

        Raises:
            InvalidConfigError: the network is for another category, or makes no mesh by this
                method.
            InvalidRecordingError: there is no cloth in the picture.
        """
        ...


@dataclass(frozen=True)
class Design:
    """A design of reconstruction networks: how its weights are recognized, used and trained.

    Nothing is imported before one of the functions is called.

    Attributes:
        networks: names of its sizes, for `clothtrack pretrain --network`.
        extra: extra of clothtrack that the design needs.
        recognizes: function that tells whether weights belong to this design.
        load: function that makes a `Reconstructor` from weights, a kind of garment and a device.
        configuration: function that makes the training settings, a frozen dataclass, from the name
            of a training ("pretrain", "finetune", "finetune_short" or "paper"), a name of
            `networks` and a seed. Its fields are the settings of `pretrain` and `finetune`.
        pretrain: training from states, a configuration and a folder, optionally `start` (file of
            weights), `hours` (of wall time), `processes` and `progress`.
        finetune: training from weights, labeled recordings, a configuration and a folder,
            optionally `processes` and `progress`.
    """

    name: str
    networks: tuple[str, ...]
    extra: str
    modules: tuple[str, ...]
    recognizes: "Callable[[Weights], bool]"
    load: Callable[..., Reconstructor]
    configuration: Callable[..., Any]
    pretrain: "Callable[..., LearningOutcome]"
    finetune: "Callable[..., LearningOutcome]"
