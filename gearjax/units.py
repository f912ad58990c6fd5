"""Units. gearjax computes in SI units and radians: multiply inputs by these units, and divide results by them.

>>> from gearjax.units import um, arcmin
>>> amplitude = 10 * um          # metres
>>> round(1e-3 / arcmin, 3)      # 1 mrad in arcmin
3.438
"""

import math
from typing import NamedTuple

mm = 1e-3
um = 1e-6
deg = math.pi / 180
arcmin = deg / 60
arcsec = deg / 3600
rpm = 2 * math.pi / 60


class Dimension(NamedTuple):
    """A physical dimension: its name, its unit inside gearjax, and an example as a configuration writes it.

    ``shown`` and ``per_shown`` are the unit in messages and its size in SI; ``forms`` are other products of SI units
    that measure the same quantity.
    """

    name: str
    unit: str
    example: str
    shown: str
    per_shown: float = 1.0
    forms: tuple[str, ...] = ()

    @property
    def described(self) -> str:
        """The name with its article, such as ``a length`` or ``an angle``."""
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name}"

    @property
    def several(self) -> str:
        """The plural of the name, such as ``lengths`` or ``frequencies``; ``numbers`` without a unit."""
        if not self.unit:
            return "numbers"
        return {"y": f"{self.name[:-1]}ies", "s": f"{self.name}es"}.get(self.name[-1], f"{self.name}s")


LENGTH = Dimension("length", "m", "10 um", "m")
ANGLE = Dimension("angle", "rad", "90 deg", "deg", deg)
ANGULAR_SPEED = Dimension("angular speed", "rad/s", "300 rpm", "rpm", rpm)
FREQUENCY = Dimension("frequency", "Hz", "1.6 Hz", "Hz", forms=("1/s",))
TIME = Dimension("time", "s", "3 s", "s")
MASS = Dimension("mass", "kg", "3 kg", "kg")
STIFFNESS = Dimension("stiffness", "N/m", "9.2e7 N/m", "N/m", forms=("kg/s^2",))
DAMPING = Dimension("damping coefficient", "N*s/m", "400 N*s/m", "N*s/m", forms=("kg/s",))
TORSION = Dimension("torsional stiffness", "N*m/rad", "1e7 N*m/rad", "N*m/rad")
TORSION_DAMPING = Dimension("torsional damping coefficient", "N*m*s/rad", "40 N*m*s/rad", "N*m*s/rad")
TORQUE = Dimension("torque", "N*m", "30 N*m", "N*m", forms=("kg*m^2/s^2",))
LINE_STIFFNESS = Dimension("stiffness per length", "N/m/m", "14 N/mm/um", "N/mm/um", 1e9, forms=("Pa", "kg/m/s^2"))
LINE_LOAD = Dimension("load per length", "N/m", "150 N/mm", "N/mm", 1e3, forms=("kg/s^2",))
PRESSURE = Dimension("pressure", "Pa", "206 GPa", "Pa", forms=("N/m^2", "kg/m/s^2"))
INERTIA = Dimension("moment of inertia", "kg*m**2", "0.02 kg*m^2", "kg*m^2", forms=("N*m*s^2",))
RATIO = Dimension("ratio", "", "0.1", "")
