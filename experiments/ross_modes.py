"""Natural frequencies of a helical pair on bearings, in all its coordinates: gearjax against ROSS, for `ross_bench`.

Masses, bearings and the mesh, one spring at the pitch point, are those of Guo and Fang (2018, tables 1 and 3); the
pinion's rotation is held, in ROSS by a large moment of inertia. Each gear of ROSS is in the middle of a stiff shaft of
almost no mass, between two bearings at the distance that gives the tilting stiffness.

The mesh of ROSS 3.1 acts along ``(cos a cos b, sin a, sin a sin b)`` with the normal pressure angle a and the helix
angle b (`MultiRotor.compute_coupling_matrix`). The normal of a helical flank, a vector of length 1, is
``(cos a cos b, sin a, cos a sin b)``: for 20 deg, axial forces of ROSS are 0.36 times as large. Frequencies are
therefore compared twice: as ROSS has them, and with the normal in its matrix.
"""

import jax.numpy as jnp
import numpy as np
from peers import agree, by_another_python

import gearjax as gj
from gearjax.units import deg, mm

TEETH, PRESSURE_ANGLE, HELIX_ANGLES = (19, 47), 20 * deg, (9.911 * deg, 25 * deg)
MASSES, TRANSVERSE, MOMENT, MESH = (8.03, 38.99), (1.62e-2, 2.17e-1), 0.0587, 1.076e9
BEARINGS = gj.Support(x=2e8, y=2e8, z=1e8, rx=1e7, ry=1e7)

ROSS = r"""
import contextlib, io, json, sys
import numpy as np
import ross as rs

given = json.load(open(sys.argv[1]))
sine, cosine = np.sin(given["pressure_angle"]), np.cos(given["pressure_angle"])

def frequencies(machine, stiffness):
    squares = np.linalg.eigvals(np.linalg.solve(machine.M(0.0), stiffness)).real
    return np.sort(np.sqrt(np.abs(squares)))[1:12] / (2 * np.pi)  # the first one turns freely

found = []
with contextlib.redirect_stdout(io.StringIO()):
    for helix in given["helix_angles"]:
        stiff, rotors = rs.Material(name="stiff", rho=1.0, E=1e15, Poisson=0.3), []
        for side, mass, transverse, polar, teeth in zip((1, -1), *(given[key] for key in ("masses", "transverse",
                                                                                        "polar", "teeth"))):
            gear = rs.GearElement(n=1, m=mass, Id=transverse, Ip=polar, n_teeth=teeth, helix_angle=side * helix,
                                  pitch_diameter=given["module"] * teeth / np.cos(helix),
                                  pr_angle=given["pressure_angle"])
            held = [rs.BearingElement(n=n, kxx=given["x"] / 2, kyy=given["x"] / 2, kzz=given["z"] / 2, cxx=0.0, cyy=0.0,
                                      czz=0.0) for n in (0, 2)]
            shaft = rs.ShaftElement(L=np.sqrt(given["tilt"] / given["x"]), idl=0.0, odl=0.05, material=stiff)
            rotors.append(rs.Rotor([shaft, shaft], [gear], held))
        machine = rs.MultiRotor(*rotors, coupled_nodes=(1, 1), gear_mesh_stiffness=given["mesh"], orientation_angle=0.0)
        gears = machine.mesh.driving_gear, machine.mesh.driven_gear
        flat, lean = -cosine * np.cos(helix), -cosine * np.sin(helix)
        arms = [gear.pitch_diameter / 2 for gear in gears]
        normal = np.concatenate([[side * sine, -side * flat, side * lean, 0.0, -lean * arm, -flat * arm]
                                 for side, arm in zip((1.0, -1.0), arms)])
        places = [place for gear in gears for place in gear.dof_global_index.values()]
        own = machine.K(0.0)
        mended = own.copy()
        own_matrix = machine.compute_coupling_matrix()
        mended[np.ix_(places, places)] += (np.outer(normal, normal) - own_matrix) * machine.mesh.stiffness
        found.append([frequencies(machine, own).tolist(), frequencies(machine, mended).tolist()])
json.dump(found, open(sys.argv[2], "w"))
"""


def ours(helix: float) -> np.ndarray:
    """Natural frequencies of the pair on a face of 1 mm, which is one spring [Hz]."""
    width = 1 * mm
    turns = {"normal_pressure_angle": PRESSURE_ANGLE, "helix_angle": helix, "input_speed": 1.0}
    system = gj.HelicalPair(*TEETH, normal_module=6 * mm, face_width=width, slices=20, **turns)
    length = width * float(system.pair.transverse_contact_ratio) / float(jnp.cos(system.pair.base_helix_angle))
    inertia = {
        body: gj.BodyInertia(mass, transverse=transverse)
        for body, mass, transverse in zip(system.bodies, MASSES, TRANSVERSE, strict=True)
    }
    scene = gj.Scene(
        system,
        compliance=gj.LineStiffness(MESH / length),
        inertia=gj.MomentOfInertia(MOMENT),
        load=gj.ConstantLoad(),
        supports=dict.fromkeys(system.bodies, BEARINGS),
        body_inertia=inertia,
    )
    return np.asarray(gj.natural_modes(scene, 830.0).frequencies)


def compare_modes(python: str) -> None:
    """Frequencies of both programs; the bench ends with an error where they differ by more than they may."""
    given = {
        **{"teeth": TEETH, "module": 6 * mm, "pressure_angle": PRESSURE_ANGLE, "helix_angles": HELIX_ANGLES},
        **{"masses": MASSES, "transverse": TRANSVERSE, "polar": (1e7, MOMENT), "mesh": MESH},
        **{"x": 2e8, "z": 1e8, "tilt": 1e7},
    }
    found = by_another_python(python, ROSS, given)
    for helix, (as_it_is, mended) in zip(HELIX_ANGLES, found, strict=True):
        own = ours(helix)
        words = f"helix angle {helix / deg:.4g} deg, natural frequencies"
        print(f"{words}: ROSS as it is differs by up to {100 * np.abs(as_it_is / own - 1).max():.2g} %")
        agree(f"{words}, with the normal of the flanks in ROSS", np.abs(mended / own - 1).max(), 5e-3)
