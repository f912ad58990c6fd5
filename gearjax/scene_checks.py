"""Checks that the parts of a scene suit each other, and that the scene lists all parts that an analysis needs."""

import dataclasses
from collections.abc import Mapping
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np

from gearjax.checks import ParameterError, SceneError, is_concrete, nearest, with_article
from gearjax.clearance import Anchor, InitialBacklash, ZeroAtStart
from gearjax.compliance import (
    AbstractSliceCompliance,
    AbstractToothCompliance,
    AnyCompliance,
    couples,
)
from gearjax.contact import AbstractContact, CoupledSprings, HardContact, Pose, Request
from gearjax.errors import AbstractError
from gearjax.evaluate import evaluated
from gearjax.impact import MeshingImpact, Pulses
from gearjax.inertia import BodyInertia, DampingRatio, EquivalentMass, MomentOfInertia
from gearjax.load_torque import AbstractLoad
from gearjax.run import Run
from gearjax.scene import Scene
from gearjax.shafts import Shaft
from gearjax.supports import Support
from gearjax.systems import AbstractSystem
from gearjax.typing import Array, Float

SLOTS: dict[str, tuple[tuple[type, ...], str]] = {  # kinds of part that a slot takes, and an example
    "reference": ((ZeroAtStart, Anchor), "ZeroAtStart()"),
    "backlash": ((InitialBacklash,), "InitialBacklash(20e-6)"),
    "compliance": (get_args(AnyCompliance), "HarmonicStiffness(2e8, [0.1], [0.0])"),
    "load": ((AbstractLoad,), "ConstantLoad()"),
    "contact": ((AbstractContact,), "HardContact()"),
    "inertia": ((EquivalentMass, MomentOfInertia), "MomentOfInertia(0.02)"),
    "damping": ((DampingRatio,), "DampingRatio(0.05)"),
    "impact": ((MeshingImpact, Pulses), "MeshingImpact()"),
    "run": ((Run,), 'Run(3.0, 301, ("no_load",))'),
}
NAMED: dict[str, tuple[type, str]] = {  # the same for parts that have names
    "errors": (AbstractError, 'Eccentricity("wheel", 10e-6, 0.0)'),
    "supports": (Support, "Support(x=1e8)"),
    "shafts": (Shaft, 'Shaft(("wheel", "pinion"))'),
    "body_inertia": (BodyInertia, "BodyInertia(mass=3.0)"),
}


def check_slots(scene: Scene) -> None:
    """Refuse parts of a scene that are of another kind than their slot takes."""
    for slot, (kinds, example) in SLOTS.items():
        part, needed = getattr(scene, slot), slot == "contact"
        if not isinstance(part, kinds) and (needed or part is not None):
            _refuse(slot, part, f"gj.{example}" + ("" if needed else ", or None"))
    for slot, (kind, example) in NAMED.items():
        parts = getattr(scene, slot)
        if not isinstance(parts, Mapping):
            raise ParameterError(slot, parts, f'must be parts by name, such as {{"name": gj.{example}}}, or {{}}')
        for name, part in parts.items():
            if not isinstance(part, kind):
                _refuse(f"{slot}.{name}", part, f"gj.{example}")


def _refuse(place: str, part: object, right: str) -> None:
    if isinstance(part, type):
        raise ParameterError(place, part.__name__, f"is a class: give a part with its numbers, such as {right}")
    raise ParameterError(place, part, f"must be a part such as {right}")


def check_body(system: AbstractSystem, key: str, error: AbstractError) -> None:
    """Refuse an error whose body the gear set does not have, or that has no pins or teeth to carry it."""
    try:
        if error.body not in system.bodies:
            raise ParameterError("body", error.body, nearest(error.body, system.bodies))
        if error.on_rim:
            _check_rim(system, error)
        else:
            error.check(lambda: system.gear_size(error.body))
    except ParameterError as fault:
        others = [_rim_fault(system, error, body) for body in system.bodies] if fault.key == "body" else [None]
        faults = [other for other in others if other is not None and other.key == "body"]
        if faults and len(faults) == len(others):
            words = f"each body of this {system.kind} {faults[0].right}"
            raise ParameterError(f"errors.{key}.kind", error.kind, words) from fault
        raise ParameterError(f"errors.{key}.{fault.key}", fault.given, fault.right) from fault


def _check_rim(system: AbstractSystem, error: AbstractError) -> None:
    jax.eval_shape(_gap, system, error)  # JAX keeps what it found for parts of the same structure
    error.check(lambda: system.gear_size(error.body))


def _gap(system: AbstractSystem, error: AbstractError) -> Array:
    seen = system.pose(jnp.zeros_like(system.input_speed), Request(bodies=(error.body,)))
    return error.gap(seen.views[error.body])


def _rim_fault(system: AbstractSystem, error: AbstractError, body: str) -> ParameterError | None:
    """Why a body cannot carry an error; ``None`` where it can."""
    try:
        if error.on_rim:
            _check_rim(system, dataclasses.replace(error, body=body))
    except ParameterError as fault:
        return fault
    return None


def check_moving(scene: Scene) -> None:
    """Refuse supports, shafts and inertia that do not suit the gear set."""
    system, coordinates = scene.system, scene.moving.coordinates
    for body, inertia in scene.body_inertia.items():
        needs = coordinates.needs(body)
        if body not in system.coordinates and system.coordinates:
            raise ParameterError("inertia", body, nearest(body, system.coordinates))
        if not needs:
            words = f"is for a body that can move: list [supports.{body}], or leave out [inertia.{body}]"
            raise SceneError(f"[inertia.{body}] {words}")
        for key, moves in (("mass", "moves in x, y or z"), ("polar", "turns"), ("transverse", "tilts")):
            if getattr(inertia, key) is not None and key not in needs:
                raise SceneError(f"[inertia.{body}] {key} is for a body that {moves} on its own; {body} does not")
    if system.exact and not coordinates.alone:
        raise SceneError('[supports] and clearance = "exact" do not go together yet: use clearance = "linear"')
    if coordinates.free > 1:
        layout, meshes = scene.layout, len(system.meshes)
        if layout.sides_turn:
            raise SceneError("shafts that turn freely need contacts of known flanks, driving or back")
        if set(layout.mesh) != set(range(meshes)):
            words = f"Layout(..., mesh=...) must give the mesh of each contact, 0 to {meshes - 1}"
            raise SceneError(f"the layout of {system.kind} has meshes {sorted(set(layout.mesh))}: {words}")


def check_impact(scene: Scene) -> None:
    """Refuse an impact of teeth where it does not occur, or where the teeth strike each other without it."""
    system = scene.system
    if scene.impact is None:
        return
    if system.meshing_in is not None and system.meshing_in.system is system:
        words = "the teeth themselves strike each other in motion: leave out [impact], or give tip_contact"
        raise SceneError(f'[impact]: with tip_contact = "corner" {words} = "ends"')
    if system.meshing_in is None and not (isinstance(scene.impact, Pulses) and scene.springs_apart):
        raise SceneError(f"[impact] is for a helical_pair, not for {with_article(system.kind)}")


def check_coupled(scene: Scene) -> None:
    """Refuse a coupled compliance without a unique equilibrium, or together with a smooth contact law."""
    compliance = scene.compliance
    if isinstance(compliance, AbstractSliceCompliance):
        _check_slices(scene, compliance)
    if compliance is None or not couples(compliance):
        return
    if not isinstance(scene.contact, HardContact):
        raise SceneError(f'[compliance] kind = "{compliance.kind}" couples the contacts: use contact "hard"')
    if isinstance(compliance, AbstractToothCompliance) and not scene.system.has_places:
        words = f"needs the places of contacts on their teeth, which {with_article(scene.system.kind)} does not offer"
        raise SceneError(f'[compliance] kind = "{compliance.kind}" {words}')
    if not is_concrete((compliance, scene.system)):
        return
    if isinstance(compliance, AbstractToothCompliance):
        places = evaluated(_at_start, scene.system, Request(places=True)).places
        assert places is not None  # the system has them
        with jax.ensure_compile_time_eval():  # also inside the trace of something else
            compliance.check(places)
    number, influence = len(scene.layout.side), np.asarray(evaluated(_influence, scene.springs_alone))
    if influence.shape != (number, number):
        raise SceneError(f"[compliance]: its matrix has shape {influence.shape}, this scene has {number} contacts")
    if not np.isfinite(influence).all():
        words = "; candidates far from the contact have no place on their teeth: give fewer system.pairs"
        raise SceneError(f"[compliance]: its matrix is not finite{words if scene.system.has_places else ''}")
    if not np.allclose(influence, influence.T, rtol=1e-6, atol=0.0):
        raise SceneError("[compliance]: its matrix is not symmetric")
    smallest = float(np.linalg.eigvalsh(influence)[0])
    if not smallest > 0:
        raise SceneError(f"[compliance]: its matrix is not positive definite (smallest eigenvalue {smallest:.3g} m/N)")


def _check_slices(scene: Scene, compliance: AbstractSliceCompliance) -> None:
    """Refuse a compliance of slices if the gear set has no slices, or if the compliance does not suit its gears."""
    if not scene.system.has_slices:
        words = f"needs slices of contact lines, which {with_article(scene.system.kind)} does not offer"
        raise SceneError(f'[compliance] kind = "{compliance.kind}" {words}')
    if is_concrete((compliance, scene.system)):
        slices = evaluated(_at_start, scene.system, Request(slices=True)).slices
        assert slices is not None  # the system has them
        with jax.ensure_compile_time_eval():  # also inside the trace of something else
            for mesh in slices:
                compliance.check(mesh)


def _at_start(system: AbstractSystem, request: Request) -> Pose:
    return system.pose(jnp.zeros_like(system.input_speed), request)


def _influence(scene: Scene) -> Float[Array, "contact contact"]:
    springs = scene.contacts(jnp.zeros_like(scene.system.input_speed), "mean").springs
    assert isinstance(springs, CoupledSprings)
    return springs.influence


def check_result(scene: Scene, forces: Array) -> None:
    """Refuse the result of another scene, by the number of its contacts, shape (..., contact)."""
    own = len(scene.layout.side)
    if forces.shape[-1] != own:
        raise SceneError(f"the result is of another scene: it has {forces.shape[-1]} contacts, this scene has {own}")


def require(scene: Scene, what: str, *slots: str) -> None:
    """Refuse an analysis, given by name, if the scene does not list the slots that the analysis needs.

    Raises:
        SceneError: the scene does not suit the analysis; the message names both the analysis and the missing sections.
    """
    missing = [slot for slot in slots if getattr(scene, slot) is None]
    if "backlash" in missing and scene.layout.sides_turn:
        missing.remove("backlash")  # the contacts of this gear set touch both flanks without it
    if missing:
        listed = " and ".join(f"[{slot}]" for slot in missing)
        raise SceneError(f'"{what}" needs {listed}, which this scene does not list')
    if "inertia" not in slots:
        return
    if scene.compliance is not None and couples(scene.compliance):
        hint = "" if scene.is_train else "; gj.one_contact(scene, torque) reduces them to one"
        raise SceneError(f'"{what}" needs independent springs: {scene.compliance.kind} couples the contacts{hint}')
    own = scene.compliance
    if scene.system.has_slices and own is not None and not isinstance(own, AbstractSliceCompliance):
        words = "[compliance] of slices, such as line_stiffness or tooth_slices"
        if not scene.is_train:
            words += "; gj.one_contact(scene, torque) reduces all to one contact"
        raise SceneError(f'"{what}" of {with_article(scene.system.kind)} needs {words}')
    coordinates = scene.moving.coordinates
    if not scene.system.turns_evenly and (scene.shafts or scene.system.orbits):
        raise SceneError(f'"{what}" of an output that turns unevenly is only possible without shafts and cranks')
    for body in coordinates.bodies:
        given = scene.body_inertia.get(body)
        for key in coordinates.needs(body):
            if given is None or getattr(given, key) is None:
                raise SceneError(f'"{what}" needs [inertia.{body}] with {key}, which this scene does not list')


def require_springs_apart(scene: Scene, what: str) -> None:
    """Refuse an analysis if more than the output moves, or if the contacts are slices.

    Raises:
        SceneError: the scene does not suit the analysis; the message names the reason.
    """
    require_output_alone(scene, what)
    if not scene.springs_apart:
        raise SceneError(f'"{what}" needs springs of pairs of teeth, not slices of contact lines')


def require_output_alone(scene: Scene, what: str) -> None:
    """Refuse an analysis if more than the output moves.

    Raises:
        SceneError: the scene does not suit the analysis; the message names a section to leave out.
    """
    if scene.output_alone:
        return
    if scene.is_train:
        raise SceneError(f'"{what}" needs a scene in which only the output moves; in a train, shafts move too')
    words = [f"[{slot}.{name}]" for slot in ("supports", "shafts") for name in getattr(scene, slot)]
    raise SceneError(f'"{what}" needs a scene in which only the output moves: leave out {words[0]}')
