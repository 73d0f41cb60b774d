"""Cloth engines with a common interface: build with a shirt and a held vertex, step by 10 ms.

Each peer is configured as in its authors' examples for cloth of this size, with a contact distance
of 3 mm where it can be chosen. Peers are imported when they are built, so that a missing one is
skipped with a reason.
"""

from collections.abc import Callable, Mapping

import numpy as np

from clothtrack.geometry.mesh import ClothMesh

STEP_S = 0.01
CONTACT_M = 0.003
AREA_DENSITY = 0.2
FRICTION = 0.5


class Ours:
    """The XPBD solver of this package."""

    def __init__(self, mesh: ClothMesh, held: int) -> None:
        from clothtrack.recordings.recording import Table
        from clothtrack.simulation.parameters import ClothParameters, SolverConfig
        from clothtrack.simulation.solver import ClothSolver
        from clothtrack.simulation.state import Attachment

        table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
        config = SolverConfig(thickness_m=CONTACT_M, area_density=AREA_DENSITY, table=table)
        parameters = ClothParameters(table_friction=FRICTION, particle_friction=FRICTION)
        self._solver = ClothSolver(mesh, config, parameters=parameters)
        self._attachment = Attachment
        self._held = held
        self._strength = np.zeros((1, mesh.vertex_count), np.float32)
        self._strength[0, held] = 1.0
        self._targets = np.asarray(mesh.vertices, np.float32)[None].copy()

    def step(self, target: np.ndarray) -> None:
        """Advance 10 ms."""
        self._targets[0, self._held] = target
        self._solver.step(STEP_S, self._attachment(self._targets, self._strength))

    def positions(self) -> np.ndarray:
        """Return vertices [m]."""
        return self._solver.positions[0].astype(np.float64)


class MuJoCoFlex:
    """MuJoCo 4 flex: a finite-element shell, implicit, two steps of 5 ms (the stand-in world)."""

    def __init__(self, mesh: ClothMesh, held: int) -> None:
        from clothtrack_lab.world.flex import TIME_STEP_S, Fabric, FlexWorld

        fabric = Fabric(area_density=AREA_DENSITY, table_friction=FRICTION, cloth_friction=FRICTION)
        self._world = FlexWorld(mesh, fabric)
        self._tip = np.array(mesh.vertices[held])
        self._world.grasp(np.array([held]), self._tip)
        self._substeps = round(STEP_S / TIME_STEP_S)

    def step(self, target: np.ndarray) -> None:
        """Advance 10 ms."""
        for share in np.arange(1, self._substeps + 1) / self._substeps:
            self._world.move(self._tip + share * (target - self._tip))
            self._world.step()
        self._tip = target

    def positions(self) -> np.ndarray:
        """Return vertices [m]."""
        return self._world.positions


class _Newton:
    """Common base of both Newton solvers: a model on a ground plane, four substeps of 2.5 ms."""

    substeps = 4

    def __init__(self, mesh: ClothMesh, held: int) -> None:
        import newton
        import warp as wp

        self._wp = wp
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        self._add_cloth(builder, mesh)
        builder.add_ground_plane()
        self._before_finalize(builder)
        self._model = builder.finalize(device="cpu")
        self._model.soft_contact_ke = 10.0  # as in Newton's own example of a garment
        self._model.soft_contact_kd = 1e-5
        self._model.soft_contact_mu = FRICTION
        flags = self._model.particle_flags.numpy()
        flags[held] &= ~int(newton.ParticleFlags.ACTIVE)
        self._model.particle_flags.assign(flags)
        self._held = held
        self._solver = self._make_solver(newton)
        self._now, self._next = self._model.state(), self._model.state()
        self._control = self._model.control()
        self._pipeline = newton.CollisionPipeline(self._model)
        self._contacts = self._pipeline.contacts()

    def _add_cloth(self, builder, mesh: ClothMesh) -> None:
        raise NotImplementedError

    def _before_finalize(self, builder) -> None:
        pass

    def _make_solver(self, newton):
        raise NotImplementedError

    def _placed(self, mesh: ClothMesh) -> dict:
        wp = self._wp
        return {
            "pos": wp.vec3(0.0, 0.0, 0.0),
            "rot": wp.quat_identity(),
            "scale": 1.0,
            "vel": wp.vec3(0.0, 0.0, 0.0),
            "vertices": [wp.vec3(*point) for point in mesh.vertices.tolist()],
            "indices": mesh.faces.ravel().tolist(),
            "density": AREA_DENSITY,
            "particle_radius": 0.5 * CONTACT_M,
        }

    def step(self, target: np.ndarray) -> None:
        """Advance 10 ms."""
        start = self._now.particle_q.numpy()[self._held]
        self._pipeline.collide(self._now, self._contacts)
        for substep in range(self.substeps):
            place = start + (substep + 1) / self.substeps * (target - start)
            for state in (self._now, self._next):
                points = state.particle_q.numpy()  # on a CPU this is the array itself
                points[self._held] = place
            self._now.clear_forces()
            self._solver.step(
                self._now, self._next, self._control, self._contacts, STEP_S / self.substeps
            )
            self._now, self._next = self._next, self._now

    def positions(self) -> np.ndarray:
        """Return vertices [m]."""
        return self._now.particle_q.numpy().astype(np.float64)


class NewtonVBD(_Newton):
    """Newton's vertex block descent, four substeps of ten iterations."""

    def _add_cloth(self, builder, mesh: ClothMesh) -> None:
        builder.add_cloth_mesh(
            **self._placed(mesh), tri_ke=1e3, tri_ka=1e3, tri_kd=1e-4, edge_ke=1e-4, edge_kd=0.0
        )

    def _before_finalize(self, builder) -> None:
        builder.color(include_bending=True)

    def _make_solver(self, newton):
        return newton.solvers.SolverVBD(
            self._model,
            iterations=10,
            particle_enable_self_contact=True,
            particle_self_contact_margin=CONTACT_M,
            particle_self_contact_gap=0.5 * CONTACT_M,
        )


class NewtonStyle3D(_Newton):
    """Newton's Style3D, four substeps of five iterations with ten steps of its linear solver."""

    def _add_cloth(self, builder, mesh: ClothMesh) -> None:
        from newton.solvers import SolverStyle3D, style3d

        SolverStyle3D.register_custom_attributes(builder)
        flat = np.asarray(mesh.vertices)[:, :2]
        a, b, c = (flat[mesh.faces[:, k]] for k in range(3))
        faces_down = np.cross(b - a, c - a) < 0
        # The back is cut from a panel of its own, seen from its outside.
        panel = np.concatenate([flat, flat * [-1, 1]])
        indices = mesh.faces + len(flat) * faces_down[:, None]
        style3d.add_cloth_mesh(
            builder,
            **self._placed(mesh),
            panel_verts=panel.tolist(),
            panel_indices=indices.ravel().tolist(),
            tri_aniso_ke=self._wp.vec3(1e2, 1e2, 1e1),
            edge_aniso_ke=self._wp.vec3(2e-5, 1e-5, 5e-6),
        )

    def _make_solver(self, newton):
        kind = newton.solvers.SolverStyle3D
        solver = kind(self._model, config=kind.Config(iterations=5, linear_iterations=10))
        # Both sides have this radius; the built-in 3 mm would blast layers 3 mm apart off each
        # other.
        solver.collision.radius = 0.5 * CONTACT_M
        return solver


Engine = Ours | MuJoCoFlex | _Newton
PEERS: Mapping[str, Callable[[ClothMesh, int], Engine]] = {
    "mujoco_flex": MuJoCoFlex,
    "newton_style3d": NewtonStyle3D,
    "newton_vbd": NewtonVBD,
}
