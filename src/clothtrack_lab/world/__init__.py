"""The simulated world (MuJoCo, not the tracker's engine), with a noisy depth camera and a tool."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack_lab.world.bench import BenchTrajectory
    from clothtrack_lab.world.episodes import SMALL_WORLD, EpisodeConfig, simulate_trajectory
    from clothtrack_lab.world.filming import simulate
    from clothtrack_lab.world.scene import Scene
    from clothtrack_lab.world.sensor import Sensor
    from clothtrack_lab.world.simulated_episodes import SimulatedEpisode, flatten_simulated
    from clothtrack_lab.world.simulated_robot import SimulatedRobot, SimulatedRobotConfig
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "SMALL_WORLD",
    "BenchTrajectory",
    "EpisodeConfig",
    "Scene",
    "Sensor",
    "SimulatedEpisode",
    "SimulatedRobot",
    "SimulatedRobotConfig",
    "flatten_simulated",
    "simulate",
    "simulate_trajectory",
]
