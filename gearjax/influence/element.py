"""Stiffness matrix of a body meshed with eight-node bricks with incompatible modes."""

from typing import Any

import numpy as np

from gearjax.checks import MissingExtraError

AT_ONCE = 2048  # elements whose matrices are calculated together: few enough for the cache
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
    """Stresses xx, yy, zz, xy, yz, zx per strain, with engineering shear strains, shape (6, 6) [Pa]."""
    shear = 0.5 * youngs_modulus / (1 + poissons_ratio)
    bulk = youngs_modulus * poissons_ratio / ((1 + poissons_ratio) * (1 - 2 * poissons_ratio))
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = bulk
    matrix[range(6), range(6)] += shear * np.array([2, 2, 2, 1, 1, 1])
    return matrix


def stiffness(mesh: Any, youngs_modulus: float, poissons_ratio: float) -> tuple[Any, np.ndarray]:
    """Stiffness matrix of a body of hexahedra.

    Each element has its eight shape functions and three incompatible modes of its own, ``x (1 - x)`` in each of its
    directions, so that it can bend (Wilson et al. 1973). The gradients of these modes use the Jacobian of the element's
    middle, so that an element of any shape represents constant strains exactly (Taylor, Beresford, Wilson 1976). The
    modes are eliminated element by element.

    Args:
        mesh: ``skfem.MeshHex``, nodes in [m].
        youngs_modulus: Young's modulus [Pa].
        poissons_ratio: Poisson's ratio [-].

    Returns:
        The matrix [N/m], and the row of each displacement of each node in it, shape (3, node).
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
    # an element's displacements are in the order first node, second node, ...
    at = places.element_dofs.T
    rows, columns = np.repeat(at, 24, axis=1).ravel(), np.tile(at, (1, 24)).ravel()
    from scipy import sparse  # this import takes a tenth of a second, and only this function needs it

    matrix = sparse.coo_array((values.ravel(), (rows, columns)), shape=(places.N, places.N)).tocsc()
    return matrix, places.nodal_dofs


def _condensed(mesh: Any, element: Any, law: np.ndarray, some: np.ndarray) -> np.ndarray:
    """Stiffness matrices of some elements, their incompatible modes eliminated, shape (element, 24, 24) [N/m]."""
    points = np.stack(np.meshgrid(GAUSS, GAUSS, GAUSS, indexing="ij")).reshape(3, 8)
    mapping = mesh.mapping()
    middle = np.full((3, 1), 0.5)
    centre, size = mapping.invDF(middle, tind=some), np.abs(mapping.detDF(middle, tind=some))
    inverse, volume = mapping.invDF(points, tind=some), np.abs(mapping.detDF(points, tind=some))
    slopes = np.stack([element.lbasis(points, node)[1] for node in range(8)])  # (node, 3, point)
    shape = np.einsum("njq,jieq->eqni", slopes, inverse)
    # gradients of x (1 - x), y (1 - y), z (1 - z), with the Jacobian of the middle
    bent = np.einsum("jq,jie,eq->eqji", 1 - 2 * points, centre[..., 0], size / volume)
    strain = _strain(np.concatenate([shape, bent], axis=2))  # (element, point, 6, 33)
    stress = (law @ strain) * (volume / 8)[..., None, None]
    count = len(some)
    whole = strain.reshape(count, 48, 33).transpose(0, 2, 1) @ stress.reshape(count, 48, 33)
    outer, cross, own = whole[:, :24, :24], whole[:, 24:, :24], whole[:, 24:, 24:]
    condensed = outer - cross.transpose(0, 2, 1) @ np.linalg.solve(own, cross)
    return 0.5 * (condensed + condensed.transpose(0, 2, 1))


def _strain(slopes: np.ndarray) -> np.ndarray:
    """Strains per displacement of functions with given gradients, from (..., function, 3) to (..., 6, 3 functions)."""
    *lead, functions, _ = slopes.shape
    strain = np.zeros((*lead, 6, functions, 3))
    for axis in range(3):
        strain[..., axis, :, axis] = slopes[..., axis]
    for row, (one, other) in enumerate([(0, 1), (1, 2), (2, 0)], start=3):
        strain[..., row, :, one] = slopes[..., other]
        strain[..., row, :, other] = slopes[..., one]
    return strain.reshape(*lead, 6, 3 * functions)
