"""Scenes whose figures are a little off, as those of a real instrument would be."""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np

from cadenza.errors import CadenzaError
from cadenza.scene.scene import Scene


def perturbed(scene: Scene, rng: np.random.Generator, amount: float = 0.1) -> Scene:
    """A copy of `scene` in which every part's figures are scaled by 1 - `amount` to 1 + `amount`.

    Drawn uniformly, one factor each, are those of

    - the mass of each body, keys included, with its inertia; the weight of the hands stays
      compensated where it is,
    - the inertia that each joint's motor adds (armature),
    - the damping and the dry friction of each joint,
    - the stiffness of each key's spring,
    - the stiffness of each servo, gain and bias alike, so that it comes to rest where it did,
    - the friction of all contacts, in common: two surfaces that touch take the greater of theirs,
      so that factors of their own would make it more on the whole.

    Sizes, places, ranges and the limits of forces stay.

    Raises:
        CadenzaError: the amount is negative, or 1 or more.
    """
    if not 0 <= amount < 1:
        raise CadenzaError(f"amount {amount}: choose 0 or more and less than 1")
    model = copy.copy(scene.model)

    def factors(count: int) -> np.ndarray:
        return rng.uniform(1.0 - amount, 1.0 + amount, count)

    mass, gain = factors(model.nbody), factors(model.nu)
    model.body_mass *= mass
    model.body_inertia *= mass[:, None]
    model.dof_armature *= factors(model.nv)
    model.dof_damping *= factors(model.nv)
    model.dof_frictionloss *= factors(model.nv)
    model.jnt_stiffness *= factors(model.njnt)
    model.actuator_gainprm *= gain[:, None]
    model.actuator_biasprm *= gain[:, None]
    model.geom_friction *= factors(1)
    mujoco.mj_setConst(model, mujoco.MjData(model))  # what follows from masses
    return replace(scene, model=model)
