"""What a reconstruction network must answer, and what is known of each design without loading it.

The token network is the core's own. Packages bring others as entry points of `clothtrack.networks`
(`model_loading.designs`).
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
    """A trained network that makes meshes of pictures.

    Attributes:
        states_error: whether it says how far off each vertex may be.
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
        """Return the full mesh behind a depth picture.

        Args:
            picture: depth, mask, camera and table; world z up.
            kind: "towel", "tshirt" or "trousers", as far as the network knows them.
            method: "template" lays the garment's own mesh into the picture; "implicit" takes the
                surface of a predicted field and may find none.
            size_m: width and length of the garment when known [m]; else taken from the picture.
            template: the flat garment itself, canonical coordinates filled; instead of `size_m`.
            vertex_count: of a template that is made here, about.
            refined: fine-tune the mesh to the picture.
            untangle: undo passages of the mesh through itself, before it is fine-tuned and after.
            observation: what it is fine-tuned to; the picture's own points when None.
            device: where to compute.

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
        name: of the design.
        networks: names of its sizes, for `clothtrack pretrain --network`.
        extra: of clothtrack, which the design needs.
        modules: that the extra brings.
        recognizes: whether weights that were read are of this design.
        load: `Reconstructor` of weights, for a kind of garment and a device.
        configuration: how it is trained: a frozen dataclass by the name of a training ("pretrain",
            "finetune", "finetune_short" or "paper"), a name of `networks` and a seed. Its fields
            are the settings of `pretrain` and `finetune`.
        pretrain: from states, a configuration and a folder, optionally `start` (file of weights),
            `hours` (of wall time), `processes` and `progress`.
        finetune: from weights, labeled recordings, a configuration and a folder, optionally
            `processes` and `progress`.
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
