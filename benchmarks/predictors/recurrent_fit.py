"""Fit a recurrent model with jax-sysid, in a Python of its own: it needs an older JAX than airpuck.

    python recurrent_fit.py DATA.npz MODEL.npz

DATA holds inputs `u` (N, m), outputs `y` (N, 3), and the numbers of `states` and hidden `units`.
"""

from __future__ import annotations

import sys

import jax
import jax.numpy as jnp
import numpy as np
from jax_sysid.models import Model  # pyright: ignore[reportMissingImports]

#: Evaluations of Adam and of L-BFGS.
_ADAM, _LBFGS = 1000, 1500


def state(x, u, weights):
    a, b, w1, w2, w3, b1 = weights[:6]
    return a @ x + b @ u + w3 @ jnp.tanh(w1 @ x + w2 @ u + b1)


def output(x, u, weights):
    c, d, w4, b3, w5, b4 = weights[6:]
    return c @ x + d @ u + w5 @ jnp.tanh(w4 @ x + b3) + b4


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    data, file = np.load(sys.argv[1]), sys.argv[2]
    u, y, states, units = data["u"], data["y"], int(data["states"]), int(data["units"])
    m = u.shape[1]
    random = np.random.default_rng(0)
    shapes = [(states, states), (states, m), (units, states), (units, m), (states, units), (units,)]
    shapes += [(3, states), (3, m), (units, states), (units,), (3, units), (3,)]
    weights = [0.1 * random.standard_normal(shape) for shape in shapes]
    weights[0] = 0.5 * np.eye(states)
    model = Model(states, 3, m, state_fcn=state, output_fcn=output)
    model.init(params=weights)
    model.loss(rho_x0=1e-4, rho_th=1e-4)
    model.optimization(adam_epochs=_ADAM, lbfgs_epochs=_LBFGS)
    model.fit(y, u)
    np.savez(file, *[np.asarray(part) for part in model.params])


if __name__ == "__main__":
    main()
