"""What the paper states (Huang, Lin and Held, arXiv 2302.09502), by experiment and method.

Chamfer distances in 1e-4 m^2, of the last action before TTO2; the paper prints "1e-4 m", but its
base model's evaluation sums mean squared distances (docs/method.md). Its cloth has 3,906 vertices
on average, its recordings are its own: only the order can be compared, not the value.
"""

from collections.abc import Mapping

PAPER: Mapping[str, Mapping[str, float]] = {
    "table1": {
        "paper": 1.13,
        "no_pseudo_action": 1.62,
        "no_dynamics_initialization": 1.40,
        "no_action_conditioning": 3.72,
        "no_final_alignment": 2.19,
        "reconstruction_network": 3.0,
    },
    "calibration": {"paper, online": 1.13, "paper, offline": 1.90},
    "final_alignment": {
        "best, with TTO2": 1.13,
        "50 %, with TTO2": 1.18,
        "90 %, with TTO2": 1.35,
        "best, without TTO2": 2.19,
        "50 %, without TTO2": 2.67,
        "90 %, without TTO2": 2.85,
    },
    "collision": {"paper, with rigidity": 4099, "paper, without rigidity": 33765},
    "network_alone": {"network, implicit, fine-tuned at test time": 3.0},
}
