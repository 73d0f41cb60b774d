"""Physics of the simulated world: a thin finite-element shell on a table, in MuJoCo.

It shares nothing with the tracker's position-based cloth. Elasticity comes from a shell with
bending, contact is between thin faces with friction cones, and time stepping is implicit. So the
tracker cannot calibrate away model differences here, just as in reality.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import InvalidConfigError, SimulationDivergedError
from clothtrack.geometry.mesh import ClothMesh

TIME_STEP_S = 0.005
CONTACT_RADIUS_M = 0.0015
_GRASP_SLOTS = 8
_GRASP_TIME_CONSTANT_S = 2.0 * TIME_STEP_S
"""Smallest time constant that MuJoCo allows for a constraint at this time step [s]."""

_GRASP_IMPEDANCE = "0.99 0.999 0.001"
"""Hardness of a grasp (MuJoCo's solimp). With the default a vertex of some milligrams trails the
tip by centimeters when the whole cloth is dragged."""
_PARKED_M = (0.0, 0.0, 5.0)
USUAL_CONTACT_S = 0.02
"""Time constant of a contact between two layers [s], MuJoCo's default."""

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class Fabric:
    """The material of a cloth, and its friction with the table.

    Attributes:
        young_pa: Young's modulus [Pa]; 4e4 at half a millimeter hangs like a cotton shirt.
        thickness_m: thickness of the elastic shell [m]; bending stiffness grows with its cube.
        area_density: mass per area [kg/m^2].
        damping_s: stiffness-proportional damping of the shell [s].
        contact_radius_m: half the distance between two layers [m]; the cloth lies at this height.
    """

    young_pa: float = 4e4
    poisson: float = 0.2
    thickness_m: float = 0.5e-3
    area_density: float = 0.2
    damping_s: float = 1e-2
    table_friction: float = 0.5
    cloth_friction: float = 0.5
    contact_radius_m: float = CONTACT_RADIUS_M

    @classmethod
    def sample(cls, rng: np.random.Generator) -> "Fabric":
        """Return a random fabric from the range of ordinary knitted and woven cloth."""
        return cls(
            young_pa=float(rng.uniform(2.5e4, 6e4)),
            poisson=float(rng.uniform(0.1, 0.3)),
            thickness_m=float(rng.uniform(0.4e-3, 0.65e-3)),
            area_density=float(rng.uniform(0.15, 0.28)),
            table_friction=float(rng.uniform(0.35, 0.8)),
            cloth_friction=float(rng.uniform(0.3, 0.7)),
        )


class FlexWorld:
    """A cloth on a table, and a gripper that holds some of its vertices.

    The table is the plane z = 0 of the world frame; gravity points down.
    """

    def __init__(
        self, mesh: ClothMesh, fabric: Fabric, *, contact_s: float = USUAL_CONTACT_S
    ) -> None:
        """Place the cloth at its vertices, unstretched and at rest.

        Args:
            contact_s: time constant with which two layers are pushed apart [s], at least two time
                steps. The usual one suits folding a lying cloth. A dropped shirt passes through
                itself with it (100 edges through triangles), and hardly with half of it.
        """
        if not contact_s >= 2.0 * TIME_STEP_S:
            raise InvalidConfigError(
                f"contact_s is {contact_s}; give at least two time steps ({2.0 * TIME_STEP_S} s)"
            )
        lowest = float(mesh.vertices[:, 2].min())
        if lowest < 0.0:
            raise InvalidConfigError(
                f"the cloth starts {-lowest:.4g} m under the table (z = 0); lift the mesh"
            )
        self._model = mujoco.MjModel.from_xml_string(_scene(mesh, fabric, contact_s))
        self._data = mujoco.MjData(self._model)
        joints = self._model.body_jntadr[self._model.flex_vertbodyid]
        self._first = self._model.jnt_qposadr[joints]
        self._start = np.array(mesh.vertices, dtype=np.float64)
        self._tip = np.array(_PARKED_M)
        mujoco.mj_forward(self._model, self._data)

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return float(self._data.time)

    @property
    def positions(self) -> Float[np.ndarray, "vertices 3"]:
        """Vertex positions [m] at the end of the last step."""
        return self._start + self._data.qpos[self._first[:, None] + np.arange(3)]

    @property
    def speed_rms(self) -> float:
        """Root mean square speed of the vertices [m/s]."""
        return float(np.sqrt(3.0 * np.mean(np.square(self._data.qvel))))

    def grasp(self, vertices: Int[np.ndarray, " held"], tip: Float[np.ndarray, " 3"]) -> None:
        """Close the gripper at `tip` [m]; these vertices follow it with constant offsets."""
        if len(vertices) > _GRASP_SLOTS:
            raise InvalidConfigError(
                f"{len(vertices)} vertices to grasp; the gripper holds at most {_GRASP_SLOTS}"
            )
        self.release()
        self._data.mocap_pos[0] = self._tip = np.array(tip)
        offsets = self.positions[vertices] - tip
        for slot, (vertex, offset) in enumerate(zip(vertices, offsets, strict=True)):
            # The vertex bodies are points, so the anchor in the cloth is their own origin.
            self._model.eq_obj2id[slot] = self._model.flex_vertbodyid[vertex]
            self._model.eq_data[slot, :3] = offset
            self._model.eq_data[slot, 3:6] = 0.0
            self._data.eq_active[slot] = True

    def move(self, tip: Float[np.ndarray, " 3"]) -> None:
        """Set the position of the gripper [m] for the next step.

        A critically damped constraint trails a moving body by two time constants. The same lead
        keeps the held cloth at the tip.
        """
        velocity = (tip - self._tip) / TIME_STEP_S
        self._data.mocap_pos[0] = tip + 2.0 * _GRASP_TIME_CONSTANT_S * velocity
        self._tip = np.array(tip)

    def release(self) -> None:
        """Open the gripper."""
        self._data.eq_active[:] = False

    def step(self, count: int = 1) -> None:
        """Advance by `count` steps of `TIME_STEP_S`."""
        mujoco.mj_step(self._model, self._data, count)
        if not np.isfinite(self._data.qpos).all() or self._data.warning.number[:].any():
            raise SimulationDivergedError(
                f"the simulated world diverged at {self.time_s:.3f} s; use a softer fabric "
                "(young_pa) or a finer mesh"
            )

    def save(self) -> Float[np.ndarray, " values"]:
        """Return the full state that the next step depends on; only valid while nothing is held."""
        size = mujoco.mj_stateSize(self._model, _STATE)
        state = np.empty(size)
        mujoco.mj_getState(self._model, self._data, state, _STATE)
        return state

    def restore(self, state: Float[np.ndarray, " values"]) -> None:
        """Restore a saved state of the same cloth; nothing is held then."""
        size = mujoco.mj_stateSize(self._model, _STATE)
        if len(state) != size:
            raise InvalidConfigError(
                f"a state of {len(state)} numbers for a world of {size}; it is of another cloth"
            )
        mujoco.mj_setState(self._model, self._data, np.asarray(state, dtype=np.float64), _STATE)
        self.release()
        mujoco.mj_forward(self._model, self._data)

    def settle(self, *, speed: float = 0.01, limit_s: float = 1.0) -> float:
        """Step until the cloth's rms speed [m/s] is below `speed`; return the time used [s]."""
        start = self.time_s
        while True:
            self.step()
            if self.speed_rms < speed or self.time_s - start >= limit_s:
                return self.time_s - start


def _scene(mesh: ClothMesh, fabric: Fabric, contact_s: float) -> str:
    """Return the MJCF of the table, the cloth and a gripper with inactive grasp constraints.

    The grasp constraints refer to vertex 0 until `FlexWorld.grasp` changes them. This works because
    MuJoCo evaluates a constraint's bodies anew in every step.
    """
    points = " ".join(f"{x:.9g}" for x in np.asarray(mesh.vertices, dtype=float).ravel())
    elements = " ".join(map(str, mesh.faces.ravel()))
    mass = fabric.area_density * float(mesh.vertex_areas.sum())
    grasps = "\n".join(
        '<connect body1="gripper" body2="cloth_0" anchor="0 0 0" active="false" '
        f'solref="{_GRASP_TIME_CONSTANT_S} 1" solimp="{_GRASP_IMPEDANCE}"/>'
        for _ in range(_GRASP_SLOTS)
    )
    parked = " ".join(map(str, _PARKED_M))
    return f"""
<mujoco>
  <option timestep="{TIME_STEP_S}" integrator="discrete" solver="CG" cone="pyramidal"
          tolerance="1e-5" iterations="30"/>
  <size memory="512M"/>
  <worldbody>
    <geom name="table" type="plane" size="2 2 0.1" condim="3" priority="1"
          friction="{fabric.table_friction} 0.005 0.0001"/>
    <body name="gripper" mocap="true" pos="{parked}"/>
    <flexcomp name="cloth" type="direct" dim="2" mass="{mass}" radius="{fabric.contact_radius_m}"
              point="{points}" element="{elements}">
      <contact selfcollide="auto" condim="3" solref="{contact_s} 1"
               friction="{fabric.cloth_friction} 0.005 0.0001"/>
      <elasticity young="{fabric.young_pa}" poisson="{fabric.poisson}"
                  thickness="{fabric.thickness_m}" damping="{fabric.damping_s}" elastic2d="both"/>
    </flexcomp>
  </worldbody>
  <equality>
    {grasps}
  </equality>
</mujoco>"""
