"""One substep in plain NumPy, in double precision and one vertex at a time: the tests' oracle.

It says the same as the kernels with nothing but loops. It takes contact candidates as given and
one environment; the speed limit and sleep are left to the kernels.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.constraints import (
    DistanceConstraints,
    bend_constraints,
    stretch_constraints,
)
from clothtrack.simulation.parameters import (
    CONTACT_TOLERANCE,
    ELASTIC_SUBSTEPS,
    ClothParameters,
    SolverConfig,
)


@dataclass(eq=False)
class ReferenceCloth:
    """A cloth and its motion, one environment.

    Attributes:
        mesh: rest shape.
        config: how the motion is computed.
        parameters: material.
        positions: vertices [m].
        velocities: [m/s].
        pull: rate at which a soft vertex approaches its goal [1/s]; 0 is free, -1 held.
        goals: where attached vertices go [m].
        pairs: candidates of contact, per vertex: (triangle + 1) x side and the distance kept [m].
    """

    mesh: ClothMesh
    config: SolverConfig
    parameters: ClothParameters
    positions: Float[np.ndarray, "vertices 3"]
    velocities: Float[np.ndarray, "vertices 3"]
    pull: Float[np.ndarray, " vertices"]
    goals: Float[np.ndarray, "vertices 3"]
    pairs: list[list[tuple[int, float]]] | None = None

    def substep(self, substep_s: float, substeps_left: int) -> None:
        """Advance by one substep [s], of which `substeps_left` remain in the step."""
        config = self.config
        parts = ELASTIC_SUBSTEPS
        elastic_s = substep_s / parts
        masses = self.mesh.vertex_areas * config.area_density
        held = self.pull == -1.0
        inverse = np.where(held, 0.0, 1.0 / masses)
        turn = np.where(held, 0.0, self.pull)[:, None] * substep_s
        start = self.positions.copy()
        positions = self.positions.copy()
        velocities = self.velocities + turn**2 / substep_s * (self.goals - positions)
        velocities /= (1.0 + turn) ** 2
        weight = np.where(turn > 0.0, 0.0, 1.0) * np.array(config.gravity)
        for part in range(parts):
            previous = positions.copy()
            velocities = (velocities + elastic_s * weight) * np.exp(-config.damping * elastic_s)
            way = (self.goals - positions) / (substeps_left * parts - part)
            positions += np.where(held[:, None], way, elastic_s * velocities)
            _solve(
                positions,
                inverse,
                stretch_constraints(self.mesh),
                self.parameters.stretch_compliance / elastic_s**2,
                buckling=config.buckling,
            )
            _solve(
                positions,
                inverse,
                bend_constraints(self.mesh),
                self.parameters.bend_compliance / elastic_s**2,
                limit=config.bend_limit,
            )
            velocities = (positions - previous) / elastic_s
        moves, stops = self._contact(positions, start, inverse, substep_s)
        self._finish(
            positions, velocities, start, inverse, moves=moves, stops=stops, substep_s=substep_s
        )

    def _contact(self, positions, start, inverse, substep_s):
        if self.pairs is not None:
            return _triangle_contact(self, positions, start, inverse, substep_s)
        return np.zeros_like(positions), np.zeros_like(positions)

    def _finish(self, positions, velocities, start, inverse, *, moves, stops, substep_s) -> None:
        table = self.config.table
        solved = positions.copy()
        for vertex in np.flatnonzero(inverse > 0.0):
            position, stopped = solved[vertex] + moves[vertex], stops[vertex].copy()
            if table is not None:
                depth = self.config.resting_height_m - (position - table.point) @ table.normal
                if depth >= 0.0:
                    slip = position - start[vertex]
                    sinking = -slip @ table.normal
                    slip += sinking * table.normal
                    position = position + depth * table.normal
                    cut = _cut(slip, self.parameters.table_friction * depth) * slip
                    position -= cut
                    stopped += np.clip(sinking, 0.0, depth) * table.normal - cut
            positions[vertex] = position
            velocities[vertex] += stopped / substep_s
        self.positions, self.velocities = positions, velocities


def _cut(slip: Float[np.ndarray, " 3"], most: float) -> float:
    return min(1.0, most / (float(np.linalg.norm(slip)) + 1e-12))


def _solve(
    positions: Float[np.ndarray, "vertices 3"],
    inverse: Float[np.ndarray, " vertices"],
    constraints: DistanceConstraints,
    softness: float,
    *,
    limit: float = 0.0,
    buckling: float = 1.0,
) -> None:
    for (first, second), length in zip(constraints.pairs, constraints.lengths, strict=True):
        weight = inverse[first] + inverse[second]
        if weight == 0.0:
            continue
        across = positions[second] - positions[first]
        distance = np.linalg.norm(across)
        if distance < limit * length:
            change = (distance - limit * length) / weight
        else:
            give = softness * (buckling if distance < length else 1.0)
            change = (distance - length) / (weight + give)
        positions[first] += inverse[first] * change / distance * across
        positions[second] -= inverse[second] * change / distance * across


def _triangle_contact(cloth: ReferenceCloth, positions, start, inverse, substep_s):
    total, stopped = np.zeros_like(positions), np.zeros_like(positions)
    active = np.zeros(len(positions))
    longest = cloth.config.push_out_speed * substep_s
    for vertex, pairs in enumerate(cloth.pairs):
        for code, kept in pairs:
            corners: Int[np.ndarray, " 3"] = cloth.mesh.faces[abs(code) - 1]
            a, b, c = positions[corners]
            normal = np.cross(b - a, c - a)
            outward = np.sign(code) * normal / np.linalg.norm(normal)
            height = (positions[vertex] - a) @ outward
            foot = np.linalg.lstsq(
                np.stack([b - a, c - a], axis=1), positions[vertex] - a, rcond=None
            )[0]
            foot = np.array([1.0 - foot.sum(), *foot])
            if height >= kept or foot.min() < -CONTACT_TOLERANCE:
                continue
            if inverse[vertex] == 0.0 and (inverse[corners] == 0.0).any():
                continue
            push = kept - height if height > 0.0 else min(kept - height, longest)
            weight = inverse[vertex] + foot**2 @ inverse[corners]
            moved = positions - start
            slip = moved[vertex] - foot @ moved[corners]
            nearing = -slip @ outward
            slip = slip + nearing * outward
            cut = _cut(slip, cloth.parameters.particle_friction * push) * slip
            impulse = (push * outward - cut) / weight
            stop = (np.clip(nearing, 0.0, push) * outward - cut) / weight
            for index, share in ((vertex, 1.0), *zip(corners, -foot, strict=True)):
                total[index] += share * impulse
                stopped[index] += share * stop
                active[index] += abs(share)
    scale = (inverse / np.maximum(active, 1.0))[:, None]
    return scale * total, scale * stopped
