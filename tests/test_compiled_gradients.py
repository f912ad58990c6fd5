"""Gradients as a user's JAX compiles them: XLA's newer compiler works numbers out once for each kernel that needs them.

Two results for one number differ by their rounding, so that ``abs``, ``maximum`` or ``where`` at exactly equal numbers
may choose differently in the parts of one gradient. Tests in this process have the older compiler.
"""

import json
import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT, with_programs_of_tests

COMPARES = """
import dataclasses, json, operator, sys
import equinox as eqx, jax, jax.numpy as jnp
jax.config.update("jax_enable_x64", True)
import gearjax as gj
from gearjax.units import mm, um

config, torque, paths, changes, errors = sys.argv[1], float(sys.argv[2]), *map(json.loads, sys.argv[3:])
scene = gj.load(config)
made = {
    "slope": lambda: gj.ProfileSlope("gear_1", jnp.asarray([3 * um])),
    "relief": lambda: gj.TipRelief("ring", jnp.asarray([2 * um]), 0.3 * mm, exponent=1),
}
own = {name: made[name]() for name in errors} if errors else scene.errors
scene = gj.Scene(
    dataclasses.replace(scene.system, **changes), own, compliance=scene.compliance, backlash=scene.backlash
)
where = operator.attrgetter(*paths)

def error(numbers, angle):
    changed = eqx.tree_at(where, scene, tuple(numbers))
    return gj.transmission_error(changed, angle[None], torque=torque).te[0]

at = jnp.asarray([float(number) for number in where(scene)])
steps = 1e-6 * jnp.maximum(jnp.abs(at), 1e-3)
slopes, value = jax.jit(jax.grad(error)), jax.jit(jax.vmap(error, in_axes=(0, None)))
worst = []
for angle in jnp.asarray([0.3, 4.3557]):
    apart = (value(at + jnp.diag(steps), angle) - value(at - jnp.diag(steps), angle)) / (2 * steps)
    worst.append(jnp.abs(slopes(at, angle) / apart - 1))
print(json.dumps(jnp.max(jnp.stack(worst), axis=0).tolist()))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "torque", "paths", "changes", "errors"),
    [
        (
            "involute_rv/yang_2019.toml",
            100.0,
            ["system.module", "system.external_shift", "system.internal_addendum", "compliance.external_width"],
            {},
            ["slope", "relief"],
        ),
        (
            "involute_rv/yang_2019.toml",
            100.0,
            ["system.module", "system.external_addendum", "compliance.rim", "compliance.internal_width"],
            {"face_points": 3, "profile_points": 3, "pairs": 9},
            [],
        ),
    ],
)
def test_gradients_of_geometry_are_those_of_differences(config, torque, paths, changes, errors):
    words = [str(ROOT / "configs" / config), str(torque), *map(json.dumps, (paths, changes, errors))]
    given = {key: word for key, word in os.environ.items() if key != "XLA_FLAGS"} | with_programs_of_tests()
    command = [sys.executable, "-c", COMPARES, *words]
    ended = subprocess.run(command, cwd=ROOT, env=given, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    deviations = json.loads(ended.stdout)
    assert len(deviations) == len(paths)
    assert max(deviations) < 1e-5, dict(zip(paths, deviations, strict=True))
