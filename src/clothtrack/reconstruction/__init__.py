"""From one depth picture to the whole mesh, hidden layers included (needs the extra [learn])."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.reconstruction.data.state_store import open_states, read_shard, write_states
    from clothtrack.reconstruction.depth_input import DepthInput, from_depth, from_recording
    from clothtrack.reconstruction.fine_tuning import finetune
    from clothtrack.reconstruction.from_picture import NetworkMesh, network_mesh
    from clothtrack.reconstruction.learning_config import LearningConfig
    from clothtrack.reconstruction.model import MeshReconstructor, Reconstruction
    from clothtrack.reconstruction.model_loading import load_model
    from clothtrack.reconstruction.refinement import Refinement, RefinementConfig, Refiner
    from clothtrack.reconstruction.template_fit import TemplateFitConfig
    from clothtrack.reconstruction.two_stages import pretrain
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "DepthInput",
    "LearningConfig",
    "MeshReconstructor",
    "NetworkMesh",
    "Reconstruction",
    "Refinement",
    "RefinementConfig",
    "Refiner",
    "TemplateFitConfig",
    "finetune",
    "from_depth",
    "from_recording",
    "load_model",
    "network_mesh",
    "open_states",
    "pretrain",
    "read_shard",
    "write_states",
]
