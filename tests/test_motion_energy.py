"""Energy of a motion whose levers turn with the input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import simpson

import gearjax as gj
from gearjax.units import mm, um


@pytest.mark.parametrize(
    "inertia", [gj.EquivalentMass(3.0), pytest.param(gj.MomentOfInertia(0.004), marks=pytest.mark.slow)]
)
def test_energy_is_kept_while_levers_turn(inertia):
    """Kinetic and elastic energy change by the work of the torque and of the contacts that the input moves.

    Five pins, whose levers' mean square turns by percents: an inertia that followed it would make energy of nothing.
    """
    own = gj.RVCycloidal(5, 40 * mm, 4 * mm, 4 * mm, -20 * um, -60 * um, 40.0, discs=1)
    stiffness, torque = 1e7, 60.0
    one = gj.Scene(
        own,
        {"throw": gj.Eccentricity("throw", 5 * um, 0.3)},
        compliance=gj.HarmonicStiffness(stiffness, [], []),
        load=gj.ConstantLoad(),
        inertia=inertia,
    )
    ts = np.linspace(0.0, 0.04, 8001)
    motion = gj.simulate(one, ts, torque, stepper=gj.AdaptiveStep(1e-11, 1e-11))
    assert int(motion.result) == 0

    def seen(time):
        contacts = one.contacts(own.input_speed * time)
        return contacts.lever, contacts.gap

    (lever, gap), (lever_rate, gap_rate) = jax.vmap(lambda t: jax.jvp(seen, (t,), (jnp.ones_like(t),)))(jnp.asarray(ts))
    position, velocity = np.asarray(motion.te)[:, None], np.asarray(motion.velocity)
    overlap = np.maximum(np.asarray(lever) * position - np.asarray(gap), 0.0)
    moment = float(inertia.moment(jnp.asarray(lever[0])))
    energy = 0.5 * moment * velocity**2 + 0.5 * stiffness * (overlap**2).sum(axis=1)
    driven = stiffness * (overlap * (np.asarray(lever_rate) * position - np.asarray(gap_rate))).sum(axis=1)
    work = simpson(-torque * velocity + driven, x=ts)
    assert np.ptp(np.asarray((lever**2).mean(axis=1))) > 1e-3 * float((lever[0] ** 2).mean())
    assert np.ptp(energy) > 1e-4
    assert energy[-1] - energy[0] == pytest.approx(work, abs=1e-6 * np.ptp(energy))
