"""Contact laws: the force of an overlap, and the choice of the first of several contacts.

The law is chosen by type, and each type is compiled once. The width of a smooth law is a traced number, so that it can
be reduced step by step without compiling again. Smooth laws are for optimisation by gradients; all reported results are
evaluated with the hard contact law (`HardContact`).
"""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from gearjax.parameters import check_parameters, length
from gearjax.typing import Array, Float, Number


class AbstractContact(eqx.Module):
    """A contact law ``f = k penetration(overlap)``, with the (smooth) maximum that belongs to it."""

    kind: eqx.AbstractClassVar[str]

    @abc.abstractmethod
    def penetration(self, overlap: Float[Array, "..."]) -> Float[Array, "..."]:
        """The part of the overlap that makes a force [m]: ``max(overlap, 0)`` or a smooth approximation of it."""

    @abc.abstractmethod
    def closed(self, overlap: Float[Array, "..."]) -> Float[Array, "..."]:
        """Degree to which a contact is closed, from 0 to 1: the derivative of `penetration`."""

    @abc.abstractmethod
    def weights(self, values: Float[Array, " n"]) -> Float[Array, " n"]:
        """Weight of each value in `maximum`, the gradient of the maximum; values in metres, the weights add up to 1."""

    @abc.abstractmethod
    def maximum(self, values: Float[Array, " n"]) -> Float[Array, ""]:
        """The largest value or a smooth approximation of it [m]."""


class HardContact(AbstractContact):
    """Hard contact law: a one-sided spring without smoothing, ``max(overlap, 0)``."""

    kind: ClassVar[str] = "hard"

    def penetration(self, overlap: Float[Array, "..."]) -> Float[Array, "..."]:
        return jnp.maximum(overlap, 0.0)

    def closed(self, overlap: Float[Array, "..."]) -> Float[Array, "..."]:
        return jnp.where(overlap > 0, 1.0, 0.0).astype(overlap.dtype)

    def weights(self, values: Float[Array, " n"]) -> Float[Array, " n"]:
        return jax.nn.one_hot(jnp.argmax(values), values.shape[0], dtype=values.dtype)

    def maximum(self, values: Float[Array, " n"]) -> Float[Array, ""]:
        # the derivative of jnp.max compares each value with the maximum; in fused code the two may be rounded
        # differently, and then no value matches
        while values.shape[0] > 1:
            half = values.shape[0] // 2
            one, other = values[:half], values[half : 2 * half]
            values = jnp.concatenate([jnp.where(one >= other, one, other), values[2 * half :]])
        return values[0]


class SoftplusContact(AbstractContact):
    """Softplus law ``w log(1 + exp(overlap / w))``: infinitely smooth, but with a force also on open contacts.

    Its maximum is ``w log(sum(exp(values / w)))``. It exceeds the largest value by at most ``w log(n)``.

    Args:
        width: smoothing width w [m].
    """

    kind: ClassVar[str] = "softplus"
    width: Number = length(at_least=1e-15, at_most=1.0, example="0.5 um")

    def __check_init__(self):
        check_parameters(self)

    def penetration(self, overlap: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.width * jax.nn.softplus(overlap / self.width)

    def closed(self, overlap: Float[Array, "..."]) -> Float[Array, "..."]:
        return jax.nn.sigmoid(overlap / self.width)

    def weights(self, values: Float[Array, " n"]) -> Float[Array, " n"]:
        return jax.nn.softmax(values / self.width)

    def maximum(self, values: Float[Array, " n"]) -> Float[Array, ""]:
        return self.width * jax.nn.logsumexp(values / self.width)


class QuadraticContact(AbstractContact):
    """Quadratic law: 0 below -w, ``(overlap + w)^2 / (4 w)`` from -w to w, and the overlap above w.

    Contacts that are open by more than w have no force.

    Its maximum of two values is the same function of their difference. Its maximum of n values is the maximum of
    ``sum(weights values) - w (sum(weights^2) - 1) / 2`` over all weights on the simplex (Martins and Astudillo 2016,
    sparsemax). It is exact if one value exceeds the others by the width, and exceeds the largest value by at most
    ``w / 2``.

    Args:
        width: half-width w of the smoothed range [m].
    """

    kind: ClassVar[str] = "quadratic"
    width: Number = length(at_least=1e-15, at_most=1.0, example="0.5 um")

    def __check_init__(self):
        check_parameters(self)

    def penetration(self, overlap: Float[Array, "..."]) -> Float[Array, "..."]:
        inside = jnp.clip(overlap + self.width, 0.0, 2 * self.width)
        return inside * inside / (4 * self.width) + jnp.maximum(overlap - self.width, 0.0)

    def closed(self, overlap: Float[Array, "..."]) -> Float[Array, "..."]:
        return jnp.clip((overlap + self.width) / (2 * self.width), 0.0, 1.0)

    def weights(self, values: Float[Array, " n"]) -> Float[Array, " n"]:
        lead = jnp.maximum(values[:, None] - values[None, :], 0.0).sum(axis=0)
        taking_part = lead < self.width
        reference = jax.lax.stop_gradient(jnp.max(values))
        shifted = values - reference
        level = (jnp.where(taking_part, shifted, 0.0).sum() - self.width) / taking_part.sum().astype(values.dtype)
        return jnp.where(taking_part, (shifted - level) / self.width, 0.0)

    def maximum(self, values: Float[Array, " n"]) -> Float[Array, ""]:
        weights = self.weights(values)
        reference = jax.lax.stop_gradient(jnp.max(values))
        used = jnp.where(weights > 0, values - reference, 0.0)
        return reference + (weights * used).sum() - 0.5 * self.width * ((weights * weights).sum() - 1.0)
