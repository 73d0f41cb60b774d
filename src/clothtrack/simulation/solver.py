"""The cloth solver: steps many copies of one cloth together, each with its own material."""

import logging
import math
from collections.abc import Sequence

import numpy as np
import warp as wp
from jaxtyping import Float, Float32

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.device_arrays import overwrite
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation import kernels
from clothtrack.simulation.buffers import allocate
from clothtrack.simulation.constraints import (
    DeviceConstraints,
    bend_constraints,
    stretch_constraints,
)
from clothtrack.simulation.contact.triangle_contact import TriangleContact
from clothtrack.simulation.parameters import ELASTIC_SUBSTEPS, ClothParameters, SolverConfig
from clothtrack.simulation.state import Attachment, ClothState, ContactMemory, pull_rate

logger = logging.getLogger(__name__)


class ClothSolver:
    """Position-based cloth with contact, friction and a table (XPBD, small steps).

    A substep is captured once as a graph; a step launches it as often as its duration requires.
    Environment i of a batch has the same bits as a single run with its parameters, and a restored
    state replays bit for bit on the same device.

    Limitations: edges are in contact with creased and open edges only, and do not store their side
    between searches. Contact averages its impulses, which conserves momentum exactly only where
    the touching vertices have equal shares in their pairs. Position changes by contact, table and
    friction stretch edges without doing work, and the edges convert the stretch to speed, so a
    cloth can gain energy, up to `speed_limit`. Near the default that is rare (docs/reliability.md).

    Attributes:
        mesh: the cloth; its vertices are the rest shape.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        config: SolverConfig | None = None,
        *,
        parameters: ClothParameters | Sequence[ClothParameters] | None = None,
        environments: int = 1,
        device: str = "cpu",
    ) -> None:
        """Put every environment at rest in the rest shape of the mesh."""
        self.mesh = mesh
        self.config = config or SolverConfig()
        self.environments = environments
        self.device = device
        self._buffers = allocate(mesh, self.config.area_density, environments, device)
        self._stretch = DeviceConstraints(
            stretch_constraints(mesh), device, buckling=self.config.buckling
        )
        self._bend = DeviceConstraints(bend_constraints(mesh), device, limit=self.config.bend_limit)
        self._material = wp.zeros((4, environments), dtype=float, device=device)
        self.set_parameters(parameters or ClothParameters())
        self._contact = TriangleContact(mesh, self._buffers, self.config, self._material[3])
        self._attached = False
        self._attaching: dict[int, tuple[wp.array, wp.array, wp.Launch]] = {}
        self._clock_type = np.dtype(kernels.Clock.numpy_dtype())
        self._graphs: tuple[wp.Graph | None, wp.Graph | None] | None = None

    # State

    @property
    def positions(self) -> Float32[np.ndarray, "environments vertices 3"]:
        """Vertices of every environment [m], a copy."""
        return self._buffers.positions.numpy().copy()

    @property
    def velocities(self) -> Float32[np.ndarray, "environments vertices 3"]:
        """Velocities of every environment [m/s], a copy."""
        return self._buffers.velocities.numpy().copy()

    def set_parameters(self, parameters: ClothParameters | Sequence[ClothParameters]) -> None:
        """Set the material of the environments, one for all or one for each."""
        if isinstance(parameters, ClothParameters):
            parameters = [parameters] * self.environments
        if len(parameters) != self.environments:
            raise InvalidConfigError(
                f"{len(parameters)} ClothParameters for {self.environments} environments; "
                "give one for all or one for each"
            )
        rows = [
            (p.stretch_compliance, p.bend_compliance, p.table_friction, p.particle_friction)
            for p in parameters
        ]
        self.parameters = tuple(parameters)
        overwrite(self._material, np.array(rows, dtype=np.float32).T)

    def save(self) -> ClothState:
        """Return the full state that the next step depends on, copied to the host."""
        memory = ContactMemory(*self._contact.memory(), self._buffers.airborne.numpy().copy())
        return ClothState(self.positions, self.velocities, memory)

    def restore(self, state: ClothState) -> None:
        """Restore a saved state; a state of one environment is copied to all."""
        if state.environments not in (1, self.environments):
            raise InvalidConfigError(
                f"a state of {state.environments} environments for {self.environments}; "
                "take one of its environments"
            )
        if state.positions.shape[1] != self.mesh.vertex_count:
            raise InvalidConfigError(
                f"a state of {state.positions.shape[1]} vertices for a cloth of "
                f"{self.mesh.vertex_count}"
            )
        overwrite(self._buffers.positions, state.positions)
        overwrite(self._buffers.velocities, state.velocities)
        memory = state.contacts
        overwrite(self._buffers.airborne, memory.airborne)
        self._contact.restore(memory.sides, memory.distances, memory.counts)

    def place(self, positions: Float[np.ndarray, "*environments vertices 3"]) -> None:
        """Set the vertex positions [m] and keep the stored contact sides.

        One environment (or no environment axis) is copied to all; velocities are unchanged.
        """
        positions = np.asarray(positions, dtype=np.float32).reshape(-1, self.mesh.vertex_count, 3)
        overwrite(self._buffers.positions, positions)

    def set_velocities(self, velocities: Float[np.ndarray, "*environments vertices 3"]) -> None:
        """Set the velocities [m/s]; one environment is copied to all."""
        shaped = np.asarray(velocities, dtype=np.float32).reshape(-1, self.mesh.vertex_count, 3)
        overwrite(self._buffers.velocities, shaped)

    # Motion

    def step(
        self, duration_s: float, attachment: Attachment | None = None, *, coarseness: int = 1
    ) -> Float[np.ndarray, " environments"]:
        """Advance all environments.

        Args:
            duration_s: duration [s]; any length, divided into equal substeps.

        Returns:
            The highest speed [m/s] of a free vertex after any substep, before the speed limit. It
            reveals an explosion, and is infinite if positions are no longer finite.
        """
        search, substep = self._graphs or self._capture()
        longest_s = coarseness * self.config.substep_s
        substeps = max(1, math.ceil(duration_s / longest_s - 1e-6))
        rebuild_s = coarseness * self.config.rebuild_s
        between_searches = self._set_clock(duration_s / substeps, substeps, rebuild_s)
        self._set_attachment(attachment, duration_s)
        self._buffers.highest_speed.zero_()
        for index in range(substeps):
            if index % between_searches == 0:
                wp.capture_launch(search)
            wp.capture_launch(substep)
        return self._buffers.highest_speed.numpy().astype(np.float64)

    def _set_clock(self, substep_s: float, substeps: int, rebuild_s: float) -> int:
        between_searches = max(1, round(rebuild_s / substep_s))
        elastic_s = substep_s / ELASTIC_SUBSTEPS
        clock = np.zeros(1, self._clock_type)
        clock["substep_s"] = substep_s
        clock["elastic_s"] = elastic_s
        clock["inverse_square"] = 1.0 / elastic_s**2
        clock["decay"] = math.exp(-self.config.damping * elastic_s)
        clock["rebuild_s"] = substep_s * between_searches
        overwrite(self._buffers.clocks, clock)
        self._buffers.substeps_left.fill_(substeps)
        return between_searches

    def _set_attachment(self, attachment: Attachment | None, duration_s: float) -> None:
        if attachment is None and not self._attached:
            return
        self._attached = attachment is not None
        if attachment is None:
            nothing = np.zeros((1, self.mesh.vertex_count))
            attachment = Attachment(np.zeros((*nothing.shape, 3)), nothing)
        strength = np.asarray(attachment.strength, dtype=np.float64)
        rates = np.where(strength >= 1.0, -1.0, pull_rate(strength, duration_s))
        targets, held, launch = self._attach(max(len(rates), len(attachment.targets)))
        overwrite(targets, attachment.targets)
        overwrite(held, rates)
        launch.launch()

    def _attach(self, environments: int) -> tuple[wp.array, wp.array, wp.Launch]:
        """Return buffers for targets and rates, and the launch that copies them to environments."""
        if environments not in self._attaching:
            buffers, device = self._buffers, self.device
            shape = (environments, self.mesh.vertex_count)
            targets = wp.zeros(shape, dtype=wp.vec3, device=device)
            rates = wp.zeros(shape, dtype=float, device=device)
            point, normal, table = self._table()
            lowest = self.config.resting_height_m if table else -math.inf
            launch = wp.launch(
                kernels.attach,
                dim=buffers.shape,
                inputs=[targets, rates, buffers.masses, point, normal, lowest],
                outputs=[buffers.pull, buffers.goals, buffers.inverse_masses],
                device=device,
                record_cmd=True,
            )
            self._attaching[environments] = targets, rates, launch
        return self._attaching[environments]

    def _table(self) -> tuple[wp.vec3, wp.vec3, int]:
        if self.config.table is None:
            return wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 1.0), 0
        return wp.vec3(*self.config.table.point), wp.vec3(*self.config.table.normal), 1

    # Graphs

    def _capture(self) -> tuple[wp.Graph | None, wp.Graph | None]:
        # The first launches compile and allocate memory, which a CUDA graph capture must not do.
        state = self.save()
        self._set_clock(self.config.substep_s, 1, self.config.rebuild_s)
        self._contact.find()
        self._launch_substep()
        self.restore(state)
        with wp.ScopedCapture(device=self.device) as search:
            self._contact.find()
        with wp.ScopedCapture(device=self.device) as substep:
            self._launch_substep()
        self._graphs = search.graph, substep.graph
        return self._graphs

    def _launch_substep(self) -> None:
        buffers, config = self._buffers, self.config
        environments, vertices = buffers.shape
        threads = buffers.threads(vertices)
        inputs = [
            threads,
            buffers.clocks,
            buffers.substeps_left,
            ELASTIC_SUBSTEPS,
            wp.vec3(*config.gravity),
            buffers.pull,
            buffers.goals,
            buffers.positions,
            buffers.velocities,
            buffers.predicted,
        ]
        for part in range(ELASTIC_SUBSTEPS):
            kernel = kernels.begin_substep if part == 0 else kernels.continue_substep
            wp.launch(
                kernel,
                dim=(environments, threads),
                inputs=[*inputs, buffers.start if part == 0 else part],
                device=self.device,
            )
            self._launch_constraints()
        self._contact.push()
        self._launch_end()

    def _launch_constraints(self) -> None:
        buffers = self._buffers
        for part, compliances in ((self._stretch, 0), (self._bend, 1)):
            part.sweep(
                buffers.clocks, self._material[compliances], buffers.inverse_masses,
                buffers.positions,
            )  # fmt: skip

    def _launch_end(self) -> None:
        buffers, config = self._buffers, self.config
        point, normal, table = self._table()
        environments, vertices = buffers.shape
        threads = buffers.threads(vertices)
        wp.launch(
            kernels.end_substep,
            dim=(environments, threads),
            inputs=[
                threads,
                buffers.clocks,
                buffers.inverse_masses,
                buffers.pull,
                buffers.start,
                buffers.predicted,
                buffers.moves,
                buffers.stops,
                table,
                point,
                normal,
                config.resting_height_m,
                self._material[2],
                config.sleep_speed,
                config.speed_limit,
            ],
            outputs=[
                buffers.positions,
                buffers.velocities,
                buffers.airborne,
                buffers.highest_speed,
                buffers.substeps_left,
            ],
            device=self.device,
        )
