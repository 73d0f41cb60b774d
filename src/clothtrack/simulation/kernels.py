"""Kernels that move the cloth: integration, stretch, bend, attachment, table.

Extended position-based dynamics with small steps: Macklin, Müller, Chentanez, "XPBD" (MIG 2016,
doi:10.1145/2994258.2994272), and Macklin et al., "Small Steps in Physics Simulation" (SCA 2019,
doi:10.1145/3309486.3340247). Arrays are (environments, vertices). A thread handles one constraint
of one environment, or every `stride`-th of its vertices. On a GPU every vertex has its own thread.
On a CPU one thread handles all vertices, because there a thread costs more than its work on one
vertex.
"""

from typing import no_type_check

import warp as wp

wp.set_module_options({"enable_backward": False})

_AIRBORNE_LIMIT = wp.constant(5)
"""Substeps after its last contact during which a vertex counts as supported and may sleep."""


TINY = wp.constant(1.0e-12)
"""Keeps a quotient finite if two vertices coincide or both are held."""

HELD = wp.constant(-1.0)
"""The pull of a held vertex, which moves to its target through any obstacle."""

_NOT_NEGATIVE = wp.constant(0x7FFFFFFF)


@no_type_check
@wp.func
def nth(number: int):
    """Return the index without its sign bit, so that Warp skips its check for negative indices."""
    return number & _NOT_NEGATIVE


@no_type_check
@wp.struct
class Clock:
    """Durations that differ between steps; stored in memory, so that one graph serves all steps.

    `elastic_s` and `substep_s`: lengths of the substeps [s]; `inverse_square`: 1 / elastic_s^2
    [1/s^2]; `decay`: factor by which air drag reduces a speed in an elastic substep; `rebuild_s`:
    time until the next candidate search [s].
    """

    elastic_s: float
    substep_s: float
    inverse_square: float
    decay: float
    rebuild_s: float


@no_type_check
@wp.kernel
def attach(
    targets: wp.array2d(dtype=wp.vec3),
    rates: wp.array2d(dtype=float),
    masses: wp.array(dtype=float),
    table_point: wp.vec3,
    table_normal: wp.vec3,
    resting_height: float,
    pull: wp.array2d(dtype=float),
    goals: wp.array2d(dtype=wp.vec3),
    inverse_masses: wp.array2d(dtype=float),
):
    """Copy an attachment to all environments, and move targets out of the table."""
    environment, vertex = wp.tid()
    source = wp.min(environment, targets.shape[0] - 1)
    rate = rates[source, vertex]
    goal = targets[source, vertex]
    inside = resting_height - wp.dot(goal - table_point, table_normal)
    if inside > 0.0:
        goal += inside * table_normal
    pull[environment, vertex] = rate
    goals[environment, vertex] = goal
    if rate == HELD:
        inverse_masses[environment, vertex] = 0.0
    else:
        inverse_masses[environment, vertex] = 1.0 / masses[vertex]


@no_type_check
@wp.func
def predict(
    vertex: int,
    position: wp.vec3,
    velocity: wp.vec3,
    gravity: wp.vec3,
    clock: Clock,
    positions: wp.array(dtype=wp.vec3),
    predicted: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
):
    """Predict free flight with drag for one elastic substep."""
    flying = (velocity + gravity * clock.elastic_s) * clock.decay
    arrival = position + clock.elastic_s * flying
    velocities[vertex] = flying
    predicted[vertex] = arrival
    positions[vertex] = arrival


@no_type_check
@wp.func
def follow(
    vertex: int,
    position: wp.vec3,
    goal: wp.vec3,
    left: int,
    clock: Clock,
    positions: wp.array(dtype=wp.vec3),
    predicted: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
):
    """Move a held vertex by its share of the remaining distance."""
    way = (goal - position) / float(left)
    velocities[vertex] = way / clock.elastic_s
    predicted[vertex] = position + way
    positions[vertex] = position + way


@no_type_check
@wp.kernel
def begin_substep(
    stride: int,
    clocks: wp.array(dtype=Clock),
    substeps_left: wp.array(dtype=int),
    elastic_substeps: int,
    gravity: wp.vec3,
    pull: wp.array2d(dtype=float),
    goals: wp.array2d(dtype=wp.vec3),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    predicted: wp.array2d(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.vec3),
):
    """Move held vertices, apply soft pulls, then predict the free flight of the other vertices.

    A soft pull is a critically damped spring, integrated implicitly. Its effect does not depend on
    the number of substeps, and it does not oscillate. It also cancels the vertex's weight, because
    the observed target already includes the effect of gravity.
    """
    environment, thread = wp.tid()
    clock = clocks[0]
    left = substeps_left[0] * elastic_substeps
    rates = pull[environment]
    wanted = goals[environment]
    here = positions[environment]
    moving = velocities[environment]
    ahead = predicted[environment]
    before = start[environment]
    for number in range(thread, rates.shape[0], stride):
        vertex = nth(number)
        rate = rates[vertex]
        position = here[vertex]
        before[vertex] = position
        if rate == HELD:
            follow(vertex, position, wanted[vertex], left, clock, here, ahead, moving)
            continue
        velocity = moving[vertex]
        if rate > 0.0:
            turn = rate * clock.substep_s
            velocity += (rate * turn) * (wanted[vertex] - position)
            velocity /= (1.0 + turn) * (1.0 + turn)
        weight = wp.where(rate > 0.0, 0.0, 1.0) * gravity
        predict(vertex, position, velocity, weight, clock, here, ahead, moving)


@no_type_check
@wp.kernel
def continue_substep(
    stride: int,
    clocks: wp.array(dtype=Clock),
    substeps_left: wp.array(dtype=int),
    elastic_substeps: int,
    gravity: wp.vec3,
    pull: wp.array2d(dtype=float),
    goals: wp.array2d(dtype=wp.vec3),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    predicted: wp.array2d(dtype=wp.vec3),
    elastic_substep: int,
):
    """Update the velocity from the constraints, then predict the next elastic substep.

    The change is added to the predicted velocity. A difference of positions alone would lose it to
    rounding, which has a bias of one percent at these short times.
    """
    environment, thread = wp.tid()
    clock = clocks[0]
    left = substeps_left[0] * elastic_substeps - elastic_substep
    rates = pull[environment]
    wanted = goals[environment]
    here = positions[environment]
    moving = velocities[environment]
    ahead = predicted[environment]
    for number in range(thread, rates.shape[0], stride):
        vertex = nth(number)
        position = here[vertex]
        rate = rates[vertex]
        if rate == HELD:
            follow(vertex, position, wanted[vertex], left, clock, here, ahead, moving)
            continue
        velocity = moving[vertex]
        velocity += (position - ahead[vertex]) / clock.elastic_s
        weight = wp.where(rate > 0.0, 0.0, 1.0) * gravity
        predict(vertex, position, velocity, weight, clock, here, ahead, moving)


@no_type_check
@wp.kernel
def solve_distances(
    clocks: wp.array(dtype=Clock),
    pairs: wp.array(dtype=wp.vec2i),
    lengths: wp.array(dtype=float),
    first: int,
    compliances: wp.array(dtype=float),
    limit: float,
    buckling: float,
    inverse_masses: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
):
    """Run one Gauss-Seidel pass over the pairs of one color (XPBD, equation 18), a thread each.

    A pair shorter than `limit` times its rest length has no compliance. For bend pairs this is a
    sharp crease; for edges the limit is 0. Other pairs shorter than their rest length are
    `buckling` times more compliant than longer ones. This models folds finer than an edge; for bend
    pairs it is 1.
    """
    environment, place = wp.tid()
    softness = compliances[environment] * clocks[0].inverse_square
    number = first + place
    pair = pairs[number]
    weight_a = inverse_masses[environment, pair[0]]
    weight_b = inverse_masses[environment, pair[1]]
    a = positions[environment, pair[0]]
    b = positions[environment, pair[1]]
    across = b - a
    distance = wp.length(across)
    length = lengths[number]
    weight = weight_a + weight_b
    if distance < limit * length:
        length *= limit
    elif distance < length:
        weight += buckling * softness
    else:
        weight += softness
    impulse = across * ((distance - length) / (distance * weight + TINY))
    positions[environment, pair[0]] = a + weight_a * impulse
    positions[environment, pair[1]] = b - weight_b * impulse


@no_type_check
@wp.kernel
def end_substep(
    stride: int,
    clocks: wp.array(dtype=Clock),
    inverse_masses: wp.array2d(dtype=float),
    pull: wp.array2d(dtype=float),
    start: wp.array2d(dtype=wp.vec3),
    predicted: wp.array2d(dtype=wp.vec3),
    moves: wp.array2d(dtype=wp.vec3),
    stops: wp.array2d(dtype=wp.vec3),
    has_table: int,
    table_point: wp.vec3,
    table_normal: wp.vec3,
    resting_height: float,
    table_friction: wp.array(dtype=float),
    sleep_speed: float,
    speed_limit: float,
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    airborne: wp.array2d(dtype=int),
    highest_speed: wp.array(dtype=float),
    substeps_left: wp.array(dtype=int),
):
    """Apply contact and table, update the velocities, let supported slow vertices sleep.

    Contact and table stop approaching vertices. Undoing an older crossing moves a vertex but does
    not change its velocity, so that a layer that was placed inside another is not flung away.
    Pulled vertices do not sleep, because they would never reach a goal less than a millimeter away.
    """
    environment, thread = wp.tid()
    if environment == 0 and thread == 0:
        substeps_left[0] = substeps_left[0] - 1
    clock = clocks[0]
    here = positions[environment]
    moving = velocities[environment]
    ahead = predicted[environment]
    before = start[environment]
    moved_by = moves[environment]
    stopped_by = stops[environment]
    mass = inverse_masses[environment]
    pulled = pull[environment]
    aloft = airborne[environment]
    for number in range(thread, here.shape[0], stride):
        vertex = nth(number)
        solved = here[vertex]
        velocity = moving[vertex]
        velocity += (solved - ahead[vertex]) / clock.elastic_s
        if mass[vertex] == 0.0:
            aloft[vertex] = 0
            continue
        position = solved
        origin = before[vertex]
        moved = moved_by[vertex]
        stopped = stopped_by[vertex]
        still_airborne = aloft[vertex] + 1
        if wp.dot(moved, moved) > 0.0:
            position += moved
            still_airborne = 0
        if has_table == 1:
            depth = resting_height - wp.dot(position - table_point, table_normal)
            if depth >= 0.0:
                still_airborne = 0
                slip = position - origin
                sinking = -wp.dot(slip, table_normal)
                slip += sinking * table_normal
                position += depth * table_normal
                stopped += wp.clamp(sinking, 0.0, depth) * table_normal
                slipped = wp.length(slip) + 1.0e-12
                cut = slip * wp.min(1.0, table_friction[environment] * depth / slipped)
                position -= cut
                stopped -= cut
        velocity += stopped / clock.substep_s
        speed = wp.length(velocity)
        if not speed < 1.0e30:
            speed = wp.inf
        if speed > highest_speed[environment]:
            wp.atomic_max(highest_speed, environment, speed)
        if speed > speed_limit:
            velocity *= speed_limit / speed
        if still_airborne <= _AIRBORNE_LIMIT and pulled[vertex] == 0.0:
            if wp.length(position - origin) < sleep_speed * clock.substep_s:
                position = origin
                velocity = wp.vec3(0.0, 0.0, 0.0)
        here[vertex] = position
        moving[vertex] = velocity
        aloft[vertex] = wp.min(still_airborne, 1000)
