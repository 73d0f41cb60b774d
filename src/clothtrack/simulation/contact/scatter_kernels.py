"""Contact between vertices and triangles on a CPU: one thread pushes all pairs of an environment.

The impulses equal those of `triangle_push_kernels.pair_impulse` to the bit. The code is C++, where
vector instructions handle four pairs at once. A single pair would need two square roots and five
divisions, each of which waits for the one before. The impulses are then added one after another in
the order of the list, because two pairs may push the same vertex.
"""

from typing import no_type_check

import warp as wp

from clothtrack.simulation.kernels import Clock, nth

wp.set_module_options({"enable_backward": False})

Received = wp.types.vector(length=8, dtype=wp.float32)
"""Impulses that a vertex received, in two registers: moving, sum of shares; stopping, unused."""


@no_type_check
@wp.kernel
def list_in_a_row(
    faces: wp.array(dtype=wp.vec3i),
    sides: wp.array3d(dtype=int),
    distances: wp.array3d(dtype=float),
    counts: wp.array2d(dtype=int),
    corners: wp.array2d(dtype=wp.vec4i),
    keeps: wp.array2d(dtype=wp.vec2),
    totals: wp.array(dtype=int),
):
    """List an environment's pairs consecutively, so that four of them can be loaded at once.

    A pair consists of its vertex and the corners of its triangle, its side (1 or -1) and its
    distance [m]. Pairs without a side, which push nothing, pad the last four.
    """
    environment = wp.tid()
    total = int(0)
    for number in range(counts.shape[1]):
        vertex = nth(number)
        for listed in range(counts[environment, vertex]):
            slot = nth(listed)
            code = sides[environment, vertex, slot]
            face = faces[nth(wp.abs(code) - 1)]
            place = nth(total)
            corners[environment, place] = wp.vec4i(vertex, face[0], face[1], face[2])
            side = wp.where(code > 0, 1.0, -1.0)
            keeps[environment, place] = wp.vec2(side, distances[environment, vertex, slot])
            total += 1
    while total % 4 != 0:
        place = nth(total)
        corners[environment, place] = corners[environment, place - 1]
        keeps[environment, place] = wp.vec2(0.0, 0.0)
        total += 1
    totals[environment] = total


_PUSH_PAIRS = """
#ifdef __clang__  // No other compiler is given a kernel that calls this.
    typedef float Two __attribute__((ext_vector_type(2)));
    typedef float Four __attribute__((ext_vector_type(4)));
    typedef Two TwoAnywhere __attribute__((aligned(4)));
    typedef Four FourAnywhere __attribute__((aligned(4)));
    struct Vectors { Four x, y, z, w; };  // Four vectors, coordinate by coordinate.
    const int* ends = reinterpret_cast<const int*>(corners.data);
    const float* keep = reinterpret_cast<const float*>(keeps.data);
    const float* mass = inverse_masses.data;
    const float* here = reinterpret_cast<const float*>(positions.data);
    const float* before = reinterpret_cast<const float*>(start.data);
    float* got = reinterpret_cast<float*>(received.data);
    const auto load = [&](const float* from, const unsigned (&i)[4]) -> Vectors {
        Four v[4];
        for (int lane = 0; lane < 4; ++lane) {
            const float* at = from + 3 * (size_t)i[lane];
            v[lane] = __builtin_shufflevector(
                *reinterpret_cast<const TwoAnywhere*>(at), Two{at[2], mass[i[lane]]}, 0, 1, 2, 3);
        }
        const Four ab = __builtin_shufflevector(v[0], v[1], 0, 4, 1, 5);
        const Four cd = __builtin_shufflevector(v[2], v[3], 0, 4, 1, 5);
        const Four ab_end = __builtin_shufflevector(v[0], v[1], 2, 6, 3, 7);
        const Four cd_end = __builtin_shufflevector(v[2], v[3], 2, 6, 3, 7);
        return {__builtin_shufflevector(ab, cd, 0, 1, 4, 5),
                __builtin_shufflevector(ab, cd, 2, 3, 6, 7),
                __builtin_shufflevector(ab_end, cd_end, 0, 1, 4, 5),
                __builtin_shufflevector(ab_end, cd_end, 2, 3, 6, 7)};
    };
    const auto minus = [](const Vectors& a, const Vectors& b) -> Vectors {
        return {a.x - b.x, a.y - b.y, a.z - b.z, Four(0.0f)};
    };
    const auto dot = [](const Vectors& a, const Vectors& b) -> Four {
        return a.x * b.x + a.y * b.y + a.z * b.z;
    };
    const auto cross = [](const Vectors& a, const Vectors& b) -> Vectors {
        return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x, Four(0.0f)};
    };
    const auto scaled = [](const Vectors& a, Four by) -> Vectors {
        return {a.x * by, a.y * by, a.z * by, Four(0.0f)};
    };
    const auto lesser = [](Four a, Four b) -> Four { return a < b ? a : b; };
    for (int n = 0; n < total; n += 4) {
        unsigned vertex[4], i[4], j[4], k[4];
        Four side, distance;
        for (int lane = 0; lane < 4; ++lane) {
            const size_t pair = n + lane;
            vertex[lane] = ends[4 * pair], i[lane] = ends[4 * pair + 1];
            j[lane] = ends[4 * pair + 2], k[lane] = ends[4 * pair + 3];
            side[lane] = keep[2 * pair], distance[lane] = keep[2 * pair + 1];
        }
        const Vectors point = load(here, vertex);
        const Vectors a = load(here, i), b = load(here, j), c = load(here, k);
        const Vectors away = minus(point, a), ab = minus(b, a), ac = minus(c, a);
        const Vectors normal = cross(ab, ac);
        const Four squared = dot(normal, normal);
        const Vectors outward = scaled(normal, side / __builtin_elementwise_sqrt(squared));
        const Four height = dot(away, outward);
        Four push = distance - height;
        auto off = (squared < 1.0e-18f) | (push <= 0.0f);
        if (off[0] && off[1] && off[2] && off[3])
            continue;
        const Four whole = squared + 1.0e-30f;
        const Four foot_b = dot(cross(away, ac), normal) / whole;
        const Four foot_c = dot(cross(ab, away), normal) / whole;
        const Four foot_a = 1.0f - foot_b - foot_c;
        off |= lesser(lesser(foot_a, foot_b), foot_c) < -tolerance;
        push = height <= 0.0f ? lesser(push, Four(longest)) : push;
        off |= (point.w == 0.0f) & ((a.w == 0.0f) | (b.w == 0.0f) | (c.w == 0.0f));
        const Four weight = point.w
            + (foot_a * foot_a * a.w + foot_b * foot_b * b.w + foot_c * foot_c * c.w);
        off |= weight == 0.0f;
        const Vectors point_0 = load(before, vertex);
        const Vectors a_0 = load(before, i), b_0 = load(before, j), c_0 = load(before, k);
        const Vectors slid_a = scaled(minus(a, a_0), foot_a);
        const Vectors slid_b = scaled(minus(b, b_0), foot_b);
        const Vectors slid_c = scaled(minus(c, c_0), foot_c);
        Vectors slip = minus(point, point_0);
        slip = minus(slip, {slid_a.x + slid_b.x + slid_c.x, slid_a.y + slid_b.y + slid_c.y,
                            slid_a.z + slid_b.z + slid_c.z, Four(0.0f)});
        const Four nearing = -dot(slip, outward);
        slip = {slip.x + nearing * outward.x, slip.y + nearing * outward.y,
                slip.z + nearing * outward.z, Four(0.0f)};
        const Four speed = __builtin_elementwise_sqrt(dot(slip, slip));
        const Four cut = lesser(Four(1.0f), rubbing * push / (speed + 1.0e-12f));
        const Four stop = lesser(nearing < 0.0f ? Four(0.0f) : nearing, push);
        const Vectors rub = scaled(slip, cut);
        Vectors moving = minus(scaled(outward, push), rub);
        Vectors stopping = minus(scaled(outward, stop), rub);
        moving = {moving.x / weight, moving.y / weight, moving.z / weight, Four(0.0f)};
        stopping = {stopping.x / weight, stopping.y / weight, stopping.z / weight, Four(0.0f)};
        off |= !(dot(moving, moving) > 0.0f);
        for (int lane = 0; lane < 4; ++lane) {
            if (off[lane])
                continue;
            const auto give = [&](unsigned to, float share, float active) {
                FourAnywhere* sums = reinterpret_cast<FourAnywhere*>(got + 8 * (size_t)to);
                sums[0] += share * Four{moving.x[lane], moving.y[lane], moving.z[lane], active};
                sums[1] += share * Four{stopping.x[lane], stopping.y[lane], stopping.z[lane], 0.0f};
            };
            const float shares[3] = {-foot_a[lane], -foot_b[lane], -foot_c[lane]};
            const unsigned to[3] = {i[lane], j[lane], k[lane]};
            give(vertex[lane], 1.0f, 1.0f);
            for (int corner = 0; corner < 3; ++corner)
                give(to[corner], shares[corner], shares[corner] < 0.0f ? -1.0f : 1.0f);
        }
    }
#endif
"""


@no_type_check
@wp.func_native(_PUSH_PAIRS)
def _push_pairs(
    total: int,
    longest: float,
    tolerance: float,
    rubbing: float,
    corners: wp.array(dtype=wp.vec4i),
    keeps: wp.array(dtype=wp.vec2),
    inverse_masses: wp.array(dtype=float),
    positions: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.vec3),
    received: wp.array(dtype=Received),
):
    """Add the impulses of each pair to its vertex and to the corners; see `pair_impulse`."""


@no_type_check
@wp.kernel
def scatter_impulses(
    clocks: wp.array(dtype=Clock),
    tolerance: float,
    push_out_speed: float,
    friction: wp.array(dtype=float),
    corners: wp.array2d(dtype=wp.vec4i),
    keeps: wp.array2d(dtype=wp.vec2),
    totals: wp.array(dtype=int),
    inverse_masses: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.vec3),
    received: wp.array2d(dtype=Received),
    moves: wp.array2d(dtype=wp.vec3),
    stops: wp.array2d(dtype=wp.vec3),
):
    """Do the work of `find_impulses` and `gather_impulses` with one thread per environment."""
    environment = wp.tid()
    mass = inverse_masses[environment]
    got = received[environment]
    moved = moves[environment]
    stopped = stops[environment]
    for number in range(mass.shape[0]):
        got[nth(number)] = Received()
    _push_pairs(
        totals[environment], push_out_speed * clocks[0].substep_s, tolerance,
        friction[environment], corners[environment], keeps[environment], mass,
        positions[environment], start[environment], got,
    )  # fmt: skip
    for number in range(mass.shape[0]):
        vertex = nth(number)
        sums = got[vertex]
        share = wp.where(sums[3] > 0.0, mass[vertex] / wp.max(sums[3], 1.0), 1.0)
        moved[vertex] = share * wp.vec3(sums[0], sums[1], sums[2])
        stopped[vertex] = share * wp.vec3(sums[4], sums[5], sums[6])
