"""Mesh stiffness of a spur pair by the energy method: gearjax against ROSS, for `ross_bench`.

Both have bending, shear and compression of teeth with the fillet of their rack, the foundation of Sainsot et al. (2004)
and the same contact. ROSS 3.1 has plane stress, so that both take a Poisson's ratio of zero here. Otherwise it differs
in three places, and stiffness is compared twice: as ROSS has it, and with these mended:

- The foundation takes the height of the contact above the root circle for the lever of the force. It is lower, where
  the line of the force crosses the middle of the tooth; ROSS takes this lever itself for the bending of the tooth.
- The foundation is narrower than the tooth of ROSS where its fillet meets the root circle.
- The mesh turns in even steps of the pressure angle instead of its tangent, the length of roll.
"""

import jax
import jax.numpy as jnp
import numpy as np
from peers import agree, by_another_python

import gearjax as gj
from gearjax.units import deg, mm

PRESSURE_ANGLE, MODULE, WIDTH, MODULUS = 20 * deg, 2 * mm, 20 * mm, 206e9
PAIRS = ((62, 62), 35 * mm), ((25, 31), 20 * mm)  # teeth, bore; the first is the example of ROSS
CLEARANCE, PLACES = 0.25, 400
LARGEST = 2e-4  # relative difference

ROSS = r"""
import contextlib, io, json, sys
import numpy as np
import ross as rs

given = json.load(open(sys.argv[1]))
found = []
with contextlib.redirect_stdout(io.StringIO()):
    steel = rs.Material(name="steel", rho=7810.0, E=given["modulus"], G_s=given["modulus"] / 2)
    for (teeth, bore), places in zip(given["pairs"], given["places"]):
        gears = [rs.GearElementTVMS(n=n, material=steel, width=given["width"], bore_diameter=bore, n_teeth=number,
                                    module=given["module"], pr_angle=given["pressure_angle"],
                                    tip_clearance_coeff=given["clearance"]) for n, number in zip((0, 2), teeth)]
        mesh = rs.Mesh(*gears)
        own = mesh.get_stiffness_for_mesh_period("equivalent", 1, given["number"] + 1)[1][:-1]
        for gear in gears:
            gear.tooth_dict["root_angle"] = 2 * gear.tooth_dict["b"] / gear.pitch_diameter
            curve, foundation = gear._compute_involute_curve, gear._inv_kf
            def lower(beta, gear=gear, curve=curve, foundation=foundation):
                def crossing(tau):
                    y, x, *rest = curve(tau)
                    return y - x * np.tan(tau), x, *rest
                gear._compute_involute_curve = crossing
                try:
                    return foundation(beta)
                finally:
                    gear._compute_involute_curve = curve
            gear._inv_kf = lower
        mended = []
        for pairs in places:
            whole = 0.0
            for angles in pairs:
                tooth = sum(1 / gear._compute_stiffness(angle) for gear, angle in zip(gears, angles))
                whole += 1 / (1 / mesh.hertzian_stiffness + tooth)
            mended.append(whole)
        found.append([np.asarray(own).tolist(), mended])
json.dump(found, open(sys.argv[2], "w"))
"""


def system_of(teeth: tuple[int, int]) -> gj.HelicalPair:
    """The pair, with one slice across the face."""
    rack = {"addendum": 1.0, "dedendum": 1.0 + CLEARANCE, "fillet_radius": CLEARANCE / (1 - np.sin(PRESSURE_ANGLE))}
    sizes = {"normal_module": MODULE, "normal_pressure_angle": PRESSURE_ANGLE, "face_width": WIDTH}
    return gj.HelicalPair(*teeth, helix_angle=0.0, input_speed=1.0, slices=1, **sizes, **rack)


def angles_of(system: gj.HelicalPair) -> np.ndarray:
    """Input angles of a mesh, between which teeth come into contact and leave it [rad]."""
    return (np.arange(PLACES) + 0.5) / PLACES * 2 * np.pi / system.pinion_teeth


def contacts_of(system: gj.HelicalPair) -> list[list[list[float]]]:
    """Pressure angles of both gears at each pair of teeth in contact, for each input angle [rad]."""

    def at(angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        slices = system.pose(angle, gj.Request(slices=True)).slices[0]
        rolls = zip(slices.roll, slices.pair.gears, strict=True)
        return jnp.stack([jnp.arctan(roll / gear.base_radius).ravel() for roll, gear in rolls], axis=1), slices.share

    rolled, shares = (np.asarray(part) for part in jax.vmap(at)(jnp.asarray(angles_of(system))))
    return [both[share.ravel() > 0].tolist() for both, share in zip(rolled, shares, strict=True)]


def compare_stiffness(python: str) -> None:
    """Mesh stiffness of both programs; the bench ends with an error where they differ by more than they may."""
    systems = [system_of(teeth) for teeth, _ in PAIRS]
    given = {
        **{"pressure_angle": PRESSURE_ANGLE, "module": MODULE, "width": WIDTH, "modulus": MODULUS},
        **{"clearance": CLEARANCE, "number": PLACES, "pairs": PAIRS},
        "places": [contacts_of(system) for system in systems],
    }
    found = by_another_python(python, ROSS, given)
    for (teeth, bore), system, (as_it_is, mended) in zip(PAIRS, systems, found, strict=True):
        own = {}
        for root in ("fillet", "straight"):
            law = gj.ToothSlices(MODULUS, 0.0, pinion_bore=bore, wheel_bore=bore, root=root)
            stiffness = gj.mesh_stiffness(gj.Scene(system, compliance=law), angles_of(system), 1.0)
            own[root] = np.asarray(stiffness.tangent) / float(system.pair.gears[1].base_radius) ** 2
        mean, words = own["fillet"].mean(), f"spur pair {teeth[0]}/{teeth[1]}, mesh stiffness"
        others = {"ROSS as it is": np.mean(as_it_is), "gearjax with straight roots": own["straight"].mean()}
        told = ", ".join(f"{name} {100 * (value / mean - 1):+.1f} %" for name, value in others.items())
        print(f"{words}: mean {mean / 1e6:.1f} N/um, {told}")
        agree(
            f"{words}, with the foundation of ROSS mended", np.abs(np.array(mended) / own["fillet"] - 1).max(), LARGEST
        )
