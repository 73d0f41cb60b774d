"""From one depth picture to the whole mesh, hidden layers included (needs the extra [learn])."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.reconstruction.data.state_store import open_states, read_shard, write_states
    from clothtrack.reconstruction.depth_input import DepthInput, from_depth, from_recording
    from clothtrack.reconstruction.from_picture import NetworkMesh, Reconstruction, Refinement
    from clothtrack.reconstruction.model_loading import design_named, design_of, load_model
    from clothtrack.reconstruction.tokens.learning_config import LearningConfig
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "DepthInput",
    "LearningConfig",
    "NetworkMesh",
    "Reconstruction",
    "Refinement",
    "design_named",
    "design_of",
    "from_depth",
    "from_recording",
    "load_model",
    "open_states",
    "read_shard",
    "write_states",
]
