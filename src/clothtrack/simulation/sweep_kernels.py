"""Stretch and bend on a CPU: one thread solves all constraints of an environment.

The result is that of `solve_distances` for one color after another. The code is C++, because only
there one can use that the constraints of a color share no vertex: four of them are solved at once
with vector instructions. Vertices are scattered in memory, so each is loaded as a whole, and four
of them are transposed into vectors of x, y and z in registers. That is three quarters faster than
gathering coordinate by coordinate, and needs only instructions that every processor has.
"""

from typing import no_type_check

import warp as wp

from clothtrack.simulation.kernels import Clock

wp.set_module_options({"enable_backward": False})

_SOLVE_COLOR = """
    const int* ends = reinterpret_cast<const int*>(pairs.data);
    const float* rest = lengths.data;
    const float* mass = inverse_masses.data;
    float* x = reinterpret_cast<float*>(positions.data);
    int n = begin;
#ifdef __clang__  // Four at a time; the loop after it is the same for what is left.
    typedef float Two __attribute__((ext_vector_type(2)));
    typedef float Four __attribute__((ext_vector_type(4)));
    typedef Two TwoAnywhere __attribute__((aligned(4)));
    typedef Four FourAnywhere __attribute__((aligned(4)));
    const auto load = [&](size_t i) -> Four {
        const Two xy = *reinterpret_cast<const TwoAnywhere*>(x + 3 * i);
        return __builtin_shufflevector(xy, Two{x[3 * i + 2], mass[i]}, 0, 1, 2, 3);
    };
    const auto store = [&](size_t i, Four vertex) {
        *reinterpret_cast<TwoAnywhere*>(x + 3 * i) = vertex.xy;
        x[3 * i + 2] = vertex.z;
    };
    const auto transpose = [](Four& a, Four& b, Four& c, Four& d) {
        const Four ab = __builtin_shufflevector(a, b, 0, 4, 1, 5);
        const Four cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
        const Four ab_end = __builtin_shufflevector(a, b, 2, 6, 3, 7);
        const Four cd_end = __builtin_shufflevector(c, d, 2, 6, 3, 7);
        a = __builtin_shufflevector(ab, cd, 0, 1, 4, 5);
        b = __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
        c = __builtin_shufflevector(ab_end, cd_end, 0, 1, 4, 5);
        d = __builtin_shufflevector(ab_end, cd_end, 2, 3, 6, 7);
    };
    for (; n + 4 <= end; n += 4) {
        const unsigned i0 = ends[2 * n], i1 = ends[2 * n + 2];
        const unsigned i2 = ends[2 * n + 4], i3 = ends[2 * n + 6];
        const unsigned j0 = ends[2 * n + 1], j1 = ends[2 * n + 3];
        const unsigned j2 = ends[2 * n + 5], j3 = ends[2 * n + 7];
        Four ax = load(i0), ay = load(i1), az = load(i2), mass_a = load(i3);
        Four bx = load(j0), by = load(j1), bz = load(j2), mass_b = load(j3);
        transpose(ax, ay, az, mass_a);
        transpose(bx, by, bz, mass_b);
        const Four whole = *reinterpret_cast<const FourAnywhere*>(rest + n);
        const Four across_x = bx - ax, across_y = by - ay, across_z = bz - az;
        const Four distance = __builtin_elementwise_sqrt(
            across_x * across_x + across_y * across_y + across_z * across_z);
        const auto sharp = distance < limit * whole;
        const Four length = sharp ? limit * whole : whole;
        const Four give = sharp ? Four(0.0f)
            : (distance < length ? Four(buckling) : Four(1.0f)) * softness;
        const Four weight = mass_a + mass_b + give;
        const Four impulse = (distance - length) / (distance * weight + 1.0e-12f);
        const Four move_a = mass_a * impulse, move_b = mass_b * impulse;
        ax = ax + move_a * across_x;
        ay = ay + move_a * across_y;
        az = az + move_a * across_z;
        bx = bx - move_b * across_x;
        by = by - move_b * across_y;
        bz = bz - move_b * across_z;
        transpose(ax, ay, az, mass_a);
        transpose(bx, by, bz, mass_b);
        store(i0, ax), store(i1, ay), store(i2, az), store(i3, mass_a);
        store(j0, bx), store(j1, by), store(j2, bz), store(j3, mass_b);
    }
#endif
    #pragma clang loop vectorize(disable) unroll(disable)
    for (; n < end; ++n) {
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
@wp.func_native(_SOLVE_COLOR)
def _solve_color(
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
    colors: wp.array(dtype=int),
    compliances: wp.array(dtype=float),
    limit: float,
    buckling: float,
    inverse_masses: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
):
    """Run one Gauss-Seidel pass over all colors; `colors` gives the start of each, and the end.

    A pair shorter than `limit` times its rest length has no compliance. Other pairs shorter than
    their rest length are `buckling` times more compliant than longer ones.
    """
    environment = wp.tid()
    softness = compliances[environment] * clocks[0].inverse_square
    for color in range(colors.shape[0] - 1):
        _solve_color(
            pairs, lengths, colors[color], colors[color + 1], softness, limit, buckling,
            inverse_masses[environment], positions[environment],
        )  # fmt: skip
