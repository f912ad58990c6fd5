"""Stiffness of bodies meshed with bricks of eight nodes with incompatible modes."""

from typing import Any

import numpy as np

from gearjax.checks import MissingExtraError

AT_ONCE = 2048  # elements whose matrices are made together: few enough for the cache
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)


def scikit_fem() -> Any:
    """The package scikit-fem.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import skfem
    except ImportError as fault:
        raise MissingExtraError(
            "influence of teeth by finite elements needs the extra fem: pip install 'gearjax[fem]'"
        ) from fault
    return skfem


def elasticity(youngs_modulus: float, poissons_ratio: float) -> np.ndarray:
    """Stresses xx, yy, zz, xy, yz, zx per strain, those of shear counted double, shape (6, 6) [Pa]."""
    shear = 0.5 * youngs_modulus / (1 + poissons_ratio)
    bulk = youngs_modulus * poissons_ratio / ((1 + poissons_ratio) * (1 - 2 * poissons_ratio))
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = bulk
    matrix[range(6), range(6)] += shear * np.array([2, 2, 2, 1, 1, 1])
    return matrix


def stiffness(mesh: Any, youngs_modulus: float, poissons_ratio: float) -> tuple[Any, np.ndarray]:
    """Stiffness matrix of a body of hexahedra.

    To the eight shape functions of an element come three that belong to it alone, ``x (1 - x)`` in each of its
    directions, so that it can bend (Wilson et al. 1973). Their slopes are taken at the Jacobian of the middle, so that
    an element of any shape still shows constant strains exactly (Taylor, Beresford, Wilson 1976). They are eliminated
    element by element.

    Args:
        mesh: ``skfem.MeshHex``, nodes in [m].
        youngs_modulus: [Pa].
        poissons_ratio: [-].

    Returns:
        The matrix [N/m], and the place in it of each node's displacements, shape (3, node).
    """
    skfem = scikit_fem()
    element = skfem.ElementHex1()
    places = skfem.Dofs(mesh, skfem.ElementVector(element))
    law = elasticity(youngs_modulus, poissons_ratio)
    number = mesh.t.shape[1]
    values = np.empty((number, 24, 24))
    for begin in range(0, number, AT_ONCE):
        some = np.arange(begin, min(begin + AT_ONCE, number))
        values[some] = _condensed(mesh, element, law, some)
    # displacements of an element: those of its first node, of its second, ...
    at = places.element_dofs.T
    rows, columns = np.repeat(at, 24, axis=1).ravel(), np.tile(at, (1, 24)).ravel()
    from scipy import sparse  # takes a tenth of a second, which only this needs

    matrix = sparse.coo_array((values.ravel(), (rows, columns)), shape=(places.N, places.N)).tocsc()
    return matrix, places.nodal_dofs


def _condensed(mesh: Any, element: Any, law: np.ndarray, some: np.ndarray) -> np.ndarray:
    """Matrices of some elements without their own modes, shape (element, 24, 24) [N/m]."""
    points = np.stack(np.meshgrid(GAUSS, GAUSS, GAUSS, indexing="ij")).reshape(3, 8)
    mapping = mesh.mapping()
    middle = np.full((3, 1), 0.5)
    centre, size = mapping.invDF(middle, tind=some), np.abs(mapping.detDF(middle, tind=some))
    inverse, volume = mapping.invDF(points, tind=some), np.abs(mapping.detDF(points, tind=some))
    slopes = np.stack([element.lbasis(points, node)[1] for node in range(8)])  # (node, 3, point)
    shape = np.einsum("njq,jieq->eqni", slopes, inverse)
    # slopes of x (1 - x), y (1 - y), z (1 - z), with the Jacobian of the middle
    bent = np.einsum("jq,jie,eq->eqji", 1 - 2 * points, centre[..., 0], size / volume)
    strain = _strain(np.concatenate([shape, bent], axis=2))  # (element, point, 6, 33)
    stress = (law @ strain) * (volume / 8)[..., None, None]
    count = len(some)
    whole = strain.reshape(count, 48, 33).transpose(0, 2, 1) @ stress.reshape(count, 48, 33)
    outer, cross, own = whole[:, :24, :24], whole[:, 24:, :24], whole[:, 24:, 24:]
    condensed = outer - cross.transpose(0, 2, 1) @ np.linalg.solve(own, cross)
    return 0.5 * (condensed + condensed.transpose(0, 2, 1))


def _strain(slopes: np.ndarray) -> np.ndarray:
    """Strains per displacement of functions with these slopes, from (..., function, 3) to (..., 6, 3 functions)."""
    *lead, functions, _ = slopes.shape
    strain = np.zeros((*lead, 6, functions, 3))
    for axis in range(3):
        strain[..., axis, :, axis] = slopes[..., axis]
    for row, (one, other) in enumerate([(0, 1), (1, 2), (2, 0)], start=3):
        strain[..., row, :, one] = slopes[..., other]
        strain[..., row, :, other] = slopes[..., one]
    return strain.reshape(*lead, 6, 3 * functions)
