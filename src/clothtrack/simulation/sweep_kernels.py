"""Stretch and bend on a CPU: one thread goes through all constraints of an environment.

The same as `solve_distances` colour by colour, but written in C++, because only there the compiler
can be told what a colour is: its constraints share no vertex, so eight or sixteen of them may be
solved at once by vector instructions. That is more than twice as fast.
"""

from typing import no_type_check

import warp as wp

from clothtrack.simulation.kernels import Clock

wp.set_module_options({"enable_backward": False})

_SOLVE_COLOUR = """
    const int* ends = reinterpret_cast<const int*>(pairs.data);
    const float* rest = lengths.data;
    const float* mass = inverse_masses.data;
    float* x = reinterpret_cast<float*>(positions.data);
    #pragma clang loop vectorize(assume_safety) interleave(disable)
    for (int n = begin; n < end; ++n) {
        const unsigned i = ends[2 * n], j = ends[2 * n + 1];
        const float ax = x[3 * i], ay = x[3 * i + 1], az = x[3 * i + 2];
        const float bx = x[3 * j], by = x[3 * j + 1], bz = x[3 * j + 2];
        const float across_x = bx - ax, across_y = by - ay, across_z = bz - az;
        const float distance = sqrtf(
            across_x * across_x + across_y * across_y + across_z * across_z);
        const bool sharp = distance < limit * rest[n];
        const float length = sharp ? limit * rest[n] : rest[n];
        const float give = sharp ? 0.0f : (distance < length ? buckling : 1.0f) * softness;
        const float weight = mass[i] + mass[j] + give;
        const float impulse = (distance - length) / (distance * weight + 1.0e-12f);
        const float move_a = mass[i] * impulse, move_b = mass[j] * impulse;
        x[3 * i] = ax + move_a * across_x;
        x[3 * i + 1] = ay + move_a * across_y;
        x[3 * i + 2] = az + move_a * across_z;
        x[3 * j] = bx - move_b * across_x;
        x[3 * j + 1] = by - move_b * across_y;
        x[3 * j + 2] = bz - move_b * across_z;
    }
"""


@no_type_check
@wp.func_native(_SOLVE_COLOUR)
def solve_colour(
    pairs: wp.array(dtype=wp.vec2i),
    lengths: wp.array(dtype=float),
    begin: int,
    end: int,
    softness: float,
    limit: float,
    buckling: float,
    inverse_masses: wp.array(dtype=float),
    positions: wp.array(dtype=wp.vec3),
):
    """Solve constraints that share no vertex (XPBD, equation 18); see `sweep_constraints`."""


@no_type_check
@wp.kernel
def sweep_constraints(
    clocks: wp.array(dtype=Clock),
    pairs: wp.array(dtype=wp.vec2i),
    lengths: wp.array(dtype=float),
    colours: wp.array(dtype=int),
    compliances: wp.array(dtype=float),
    limit: float,
    buckling: float,
    inverse_masses: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
):
    """One Gauss-Seidel pass over all colours; `colours` says where each begins, and the end.

    A pair shorter than `limit` of its length resists without compliance; another that is shorter
    than its length gives `buckling` times more than one that is longer.
    """
    environment = wp.tid()
    softness = compliances[environment] * clocks[0].inverse_square
    for colour in range(colours.shape[0] - 1):
        solve_colour(
            pairs, lengths, colours[colour], colours[colour + 1], softness, limit, buckling,
            inverse_masses[environment], positions[environment],
        )  # fmt: skip
