"""The emulated robot body in MuJoCo: placing, stepping and reading it.

The robot first settles on its wheels without gravity along the surface, is then moved exactly to its start
pose, and only then gets its full weight.
"""

import math
from dataclasses import replace

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.errors import ConfigError, DeviceError
from hil.core.geometry import Array, ArrayLike
from hil.core.signals import WHEELS
from hil.fakes.plant.common_body import HEADING, LOAD, SteppedBody, checked_pose
from hil.fakes.plant.mujoco import step_kernels as mk
from hil.fakes.plant.mujoco.contact_settings import CREEP_FLOOR_M_S, HOLDING_IMPRATIO
from hil.fakes.plant.mujoco.mjcf import JOINTS, load_mujoco
from hil.fakes.plant.mujoco.model import Built, as_built
from hil.fakes.plant.mujoco.named_numbers import ROBOT
from hil.fakes.plant.parameters import TrueParameters
from hil.fakes.plant.robot import GRAVITY_M_S2, make_constants, make_patches
from hil.fakes.plant.step_kernel import look_from_origin
from hil.fakes.plant.surfaces import Patch
from hil.faults.plan import FaultPlan
from hil.support.numba_jit import compile_for

_SETTLE_S = 0.4
_AT_REST = 1e-3


class MujocoRobot(SteppedBody):
    """Four steered and driven wheels on an inclined plane, in MuJoCo.

    Args:
        built: the compiled model.
        parameters: true parameters; positions and radii of the wheels are read from the model.
        patches: areas with other friction.
        tilt_rad, faults, by_hand: arguments of `SteppedBody`.
        start_pose: pose (3,) of the body in the wall frame; it starts at rest.

    Attributes:
        parameters: true parameters of the model. The rolling radii of its wheels are smaller than the built
            ones by half of the penetration.

    Raises:
        ConfigError: the robot does not come to rest on its wheels.
    """

    def __init__(
        self,
        built: Built,
        parameters: TrueParameters,
        *,
        patches: tuple[Patch, ...] = (),
        tilt_rad: float = math.pi / 2.0,
        start_pose: ArrayLike = (0.0, 0.0, 0.0),
        faults: FaultPlan | None = None,
        by_hand: bool = False,
    ) -> None:
        pose = checked_pose(start_pose)
        self._built, self._mujoco = built, load_mujoco()
        p = as_built(built, parameters)
        step_ns = round(float(built.model.opt.timestep) * NS_PER_S)
        robots, data = np.zeros(1, ROBOT), built.data
        robots["constants"] = make_constants(p, tilt_rad, step_ns / NS_PER_S)
        robots["places"] = built.places
        super().__init__(p, robots, tilt_rad=tilt_rad, faults=faults, step_ns=step_ns, by_hand=by_hand)
        self._state.heading[:] = p.steering_offset_rad
        self._prepared = (
            robots,
            make_patches(patches),
            data.qpos,
            data.qvel,
            data.ctrl,
            built.model.pair_friction,
        )
        compile_for(mk.prepare, *self._prepared)
        compile_for(mk.finish, robots, data.qpos, data.qvel)
        self._settle()
        self._put(pose)

    def _settle(self) -> None:
        """Settle the robot on its wheels without gravity along the surface, and read its loads and height.

        If adhesion cannot hold it on the surface, it is pressed on by hand here and falls when released.
        """
        weight_n = self.parameters.mass_kg * GRAVITY_M_S2
        normal_m_s2 = -GRAVITY_M_S2 * math.cos(self.tilt_rad)
        if not self._rests(normal_m_s2, float(self._constants.adhesion)) and not self._rests(0.0, weight_n):
            raise self._restless()
        model, data = self._built.model, self._built.data
        model.opt.gravity[:] = -GRAVITY_M_S2 * math.sin(self.tilt_rad), 0.0, normal_m_s2
        radius_m = self.parameters.wheel_radius_m + 0.5 * self._by_wheel(data.contact.dist)
        self.parameters = replace(self.parameters, wheel_radius_m=radius_m)
        self._constants.radius[:] = radius_m
        creep = self._built.contact.ratio_times_speed(float(np.mean(data.efc_R[data.contact.efc_address])))
        settled = self._robots[0].settled
        settled.fork_inertia[:] = self._fork_inertia_kg_m2()
        settled.ratio_speed, settled.ratio, settled.slowest = creep, HOLDING_IMPRATIO, CREEP_FLOOR_M_S
        settled.height = data.qpos[2]

    def _fork_inertia_kg_m2(self) -> list[float]:
        """Inertia of each fork about its axis, including its wheel and gears."""
        model, data, found = self._built.model, self._built.data, []
        for steer in self._built.places[0].steer_v:
            turning, momentum = np.zeros(model.nv), np.zeros(model.nv)
            turning[steer] = 1.0
            self._mujoco.mj_mulM(model, data, momentum, turning)
            found.append(float(momentum[steer]))
        return found

    def _rests(self, normal_m_s2: float, press_n: float) -> bool:
        """Return whether the robot comes to rest on four wheels from its initial configuration."""
        model, data, places = self._built.model, self._built.data, self._built.places[0]
        self._mujoco.mj_resetData(model, data)
        data.qpos[places.steer_q] = self._state.heading
        self._mujoco.mj_kinematics(model, data)
        data.qpos[2] -= self._heights_m().min()
        model.opt.gravity[:] = 0.0, 0.0, normal_m_s2
        model.opt.impratio = HOLDING_IMPRATIO
        data.ctrl[self._built.fan] = press_n
        self._mujoco.mj_step(model, data, nstep=round(_SETTLE_S * NS_PER_S / self._step_ns))
        still = mk.is_sound(data.qpos, data.qvel) and float(np.abs(data.qvel).max()) < _AT_REST
        return still and bool(np.all(self._loads_n() > 0.0))

    def _restless(self) -> ConfigError:
        """Error that explains why the robot does not come to rest."""
        model, data = self._built.model, self._built.data
        where = f"emulation.mjcf = {self._built.source}: the robot does not come to rest on its wheels"
        if not mk.is_sound(data.qpos, data.qvel):
            return ConfigError(
                f"{where}: the simulation diverges", expected="heavier parts, or a smaller option timestep"
            )
        high_mm, loads_n = 1e3 * self._heights_m(), self._loads_n()
        if np.any(loads_n <= 0.0):
            off = [f"{w} by {high_mm[i]:.2g} mm" for i, w in enumerate(WHEELS) if loads_n[i] <= 0.0]
            return ConfigError(
                f"{where}: wheels are off the surface: {', '.join(off)}",
                expected="wheels whose lowest points lie in one plane, and a centre of mass between them",
            )
        fastest = int(np.argmax(np.abs(data.qvel)))
        joint = model.joint(int(model.dof_jntid[fastest])).name
        return ConfigError(
            f"{where}: {f'joint {joint}' if joint in JOINTS else 'its body'} still moves with "
            f"{abs(float(data.qvel[fastest])):.2g} {'m/s' if fastest < 3 else 'rad/s'} {_SETTLE_S} s later",
            expected="masses, inertias and an option timestep that MuJoCo's contacts can carry",
        )

    def _heights_m(self) -> Array:
        """(4,) height of the lowest point of each wheel."""
        places: Array = self._built.data.geom_xpos[list(self._built.wheel_of), 2]
        return places - self._built.radius_m

    def _loads_n(self) -> Array:
        """(4,) normal load of each wheel."""
        data = self._built.data
        return self._by_wheel(data.efc_force[data.contact.efc_address])

    def _put(self, pose: Array) -> None:
        """Move the settled robot to its start pose, at rest, with joints at zero."""
        model, data, places = self._built.model, self._built.data, self._built.places[0]
        mk.look_at_body(self._state, data.qpos, data.qvel)
        half = 0.5 * float(pose[2] - self._state.body[2])
        turned = np.zeros(4)
        self._mujoco.mju_mulQuat(turned, np.array([math.cos(half), 0.0, 0.0, math.sin(half)]), data.qpos[3:7])
        data.qpos[3:7], data.qpos[:2], data.qvel[:] = turned, pose[:2], 0.0
        data.qpos[places.drive_q] = 0.0
        data.qpos[places.steer_q] = self._state.heading
        self._state.body[:], self._state.velocity[:] = pose, 0.0
        look_from_origin(self._state, 0.0, 0.0)
        self._mujoco.mj_forward(model, data)

    def _integrate(self, n: int, adhesion_factor: float) -> None:
        built, prepare, prepared = self._built, mk.prepare, self._prepared
        model, data, step = built.model, built.data, self._mujoco.mj_step
        option = model.opt
        self._blow(adhesion_factor)
        for done in range(n):
            ratio = prepare(*prepared)
            if ratio == mk.CHECK_STATE:
                ratio = self._stumbled(done)
            option.impratio = ratio
            step(model, data)
        mk.finish(self._robots, data.qpos, data.qvel)

    def _blow(self, adhesion_factor: float) -> None:
        """Set the present forces of fan and propellers; zero for a robot that has fallen."""
        ctrl, c, held = self._built.data.ctrl, self._constants, 1.0 - self._state.fallen
        ctrl[self._built.fan] = held * adhesion_factor * c.adhesion
        ctrl[self._built.thrust] = held * c.thrust
        ctrl[self._built.turn] = held * c.thrust_torque

    def _stumbled(self, done: int) -> float:
        """Handle a robot that has just fallen, or a diverged simulation.

        Raises:
            DeviceError: the simulation has diverged, so a run with it has no result.
        """
        if not mk.is_sound(self._built.data.qpos, self._built.data.qvel):
            raise DeviceError(
                "plant",
                f"the MuJoCo simulation of {self._built.source} has diverged at "
                f"{(self._steps + done) * self._step_ns / NS_PER_S:.3f} s",
                remedy="a smaller option timestep in the MJCF, or heavier parts",
            )
        self._built.data.qvel[3:6] = 0.0  # the crash itself is not modelled: it falls as it hung
        self._built.model.opt.disableflags |= int(self._mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._blow(0.0)
        return HOLDING_IMPRATIO

    def _by_wheel(self, values: Array) -> Array:
        """Sort values (n,) of the present contacts by wheel (4,); 0 for a wheel without contact."""
        out = np.zeros(4)
        for geom, value in zip(self._built.data.contact.geom[:, 1], values, strict=True):
            out[self._built.wheel_of[int(geom)]] = value
        return out

    def steering_rad(self) -> list[float]:
        """True heading of each fork in the body frame, wheel order."""
        return self._built.data.qpos[self._built.places[0].steer_q].tolist()  # type: ignore[no-any-return]

    def _seen(self) -> Array:
        state = super()._seen()
        state[HEADING] = self.steering_rad()
        state[LOAD] = 0.0 if self._state.fallen else self._loads_n()
        return state
