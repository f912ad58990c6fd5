"""Texts of the files that model a reducer for other programs. They need numpy, or numpy and MuJoCo, but no gearjax."""

TE_FILE = '''"""Transmission error of a reducer, by orders: SI and radians. Needs only numpy; written by gearjax."""

import numpy as np

RATIO = {ratio}  # turns of the input per turn of the output
ORDERS = np.array({orders})  # cycles per turn of the input
TORQUES = np.array({torques})  # load on the output, positive resists it [N m]
MEAN = np.array({mean})  # of the transmission error under each torque [rad]
COSINE = np.array({cosine})  # of each order under each torque [rad]
SINE = np.array({sine})


def curves(theta):
    """Transmission error under each of TORQUES at input angles, shape (..., torque) [rad]."""
    angle = np.multiply.outer(np.asarray(theta, float), ORDERS)
    return MEAN + np.cos(angle) @ COSINE.T + np.sin(angle) @ SINE.T


def te(theta, torque):
    """Transmission error at input angles [rad] under load torques [N m], on straight lines between TORQUES.

    Angles and torques are numbers, or arrays that numpy can broadcast.

    Beyond the largest torques the last lines are extended. At zero torque the driving flanks touch.
    """
    return between(curves(theta), torque)


def slope(theta, torque):
    """Change of the transmission error per input angle, under a constant torque [-]."""
    angle = np.multiply.outer(np.asarray(theta, float), ORDERS)
    rates = (np.cos(angle) * ORDERS) @ SINE.T - (np.sin(angle) * ORDERS) @ COSINE.T
    return between(rates, torque)


def between(known, torque):
    """Values under a torque, interpolated from values under TORQUES, shape (..., torque)."""
    torque = np.asarray(torque, float)
    first = np.clip(np.searchsorted(TORQUES, torque) - 1, 0, len(TORQUES) - 2)
    side = TORQUES > 0
    if not side.all():  # inside the backlash no flank carries: the lines end at its edges
        last_back, first_drive = np.flatnonzero(~side)[-1], np.flatnonzero(side)[0]
        first = np.where((torque >= 0) & (first < first_drive), first_drive, first)
        first = np.where((torque < 0) & (first >= last_back), last_back - 1, first)
    low, high = TORQUES[first], TORQUES[first + 1]
    share = (torque - low) / (high - low)
    shape = np.broadcast_shapes(known.shape[:-1], first.shape)
    known = np.broadcast_to(known, (*shape, known.shape[-1]))
    place = np.broadcast_to(first, shape)[..., None]
    at, beside = np.take_along_axis(known, place, -1)[..., 0], np.take_along_axis(known, place + 1, -1)[..., 0]
    return at + share * (beside - at)


def torque_of(theta, position):
    """Load torque that holds the output at a position from its ideal one [rad], at one input angle [rad].

    Inside the backlash the torque is zero.
    """
    known = curves(theta)[::-1]  # positions fall as the torque grows
    loads = TORQUES[::-1]
    if position <= known[0] or position >= known[-1]:
        i = 0 if position <= known[0] else len(known) - 2
    else:
        i = int(np.searchsorted(known, position)) - 1
    stiffness = (loads[i + 1] - loads[i]) / (known[i + 1] - known[i])
    if min(loads) > 0:  # no back flanks: beyond the driving ones nothing is carried
        return max(loads[i] + stiffness * (position - known[i]), 0.0)
    if loads[i] * loads[i + 1] < 0:  # between the driving and the back flanks: the lines beside end at no torque
        return _beside(known, loads, i, position)
    return loads[i] + stiffness * (position - known[i])


def _beside(known, loads, i, position):
    """Torque between the last driving and the first back curve: their lines, as far as they carry."""
    drive = back = 0.0
    if i:
        drive = loads[i] + (loads[i] - loads[i - 1]) / (known[i] - known[i - 1]) * (position - known[i])
    if i + 2 < len(known):
        back = loads[i + 1] + (loads[i + 2] - loads[i + 1]) / (known[i + 2] - known[i + 1]) * (position - known[i + 1])
    return max(drive, 0.0) + min(back, 0.0)
'''

MUJOCO_FILE = '''"""Forces of a reducer between two joints of a MuJoCo model; written by gearjax.

    import mujoco, joint_mujoco
    model = mujoco.MjModel.from_xml_path("joint.xml")
    joint_mujoco.install(model)          # joints "motor" and "output"

The output turns 1 / RATIO as far as the motor. te_model.py gives the torque that the flanks carry, with backlash. The
torque on the motor follows from virtual work.
"""

import mujoco
import numpy as np
import te_model

DAMPING = {damping}  # of the output while flanks touch [N m s/rad]


def forces(theta, speed, angle, rate):
    """Torques on motor and output [N m] at their angles [rad] and speeds [rad/s]."""
    position = angle - theta / te_model.RATIO
    carried = te_model.torque_of(theta, position)
    slope = 1 / te_model.RATIO + te_model.slope(theta, 0.5 * carried)
    if carried:
        carried -= DAMPING * (rate - (1 / te_model.RATIO + te_model.slope(theta, carried)) * speed)
    return -carried * slope, carried


def install(model, motor="motor", output="output"):
    """Have MuJoCo add the reducer's forces to a model in every step."""
    places = []
    for name in (motor, output):
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        places.append((model.jnt_qposadr[joint], model.jnt_dofadr[joint]))
    (first, own), (second, other) = places

    def passive(model, data):
        on_motor, on_output = forces(data.qpos[first], data.qvel[own], data.qpos[second], data.qvel[other])
        data.qfrc_passive[own] += on_motor
        data.qfrc_passive[other] += on_output

    mujoco.set_mjcb_passive(passive)
    return passive
'''


PLACEHOLDER = 0.01  # moment of inertia of the link of a scene without [inertia] [kg m2]


def mjcf(inertia: float | None) -> str:
    """A MuJoCo model of one joint with its reducer: the rotor of a motor, and the link that the output turns."""
    assumed = "" if inertia is not None else "\n      <!-- the gear set lists no [inertia]: give that of your link -->"
    inertia = PLACEHOLDER if inertia is None else inertia
    return f"""<mujoco model="joint with a reducer">
  <!-- forces between both joints: joint_mujoco.install(model) -->
  <option timestep="1e-5" gravity="0 0 0"/>
  <worldbody>
    <body name="rotor">
      <joint name="motor" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
    </body>
    <body name="link">
      <joint name="output" type="hinge" axis="0 0 1"/>{assumed}
      <inertial pos="0 0 0" mass="1" diaginertia="{inertia:.9g} {inertia:.9g} {inertia:.9g}"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="motor"/>
    <motor name="load" joint="output"/>
  </actuator>
</mujoco>
"""
