"""Import MuJoCo, even where the graphics library is missing that MUJOCO_GL names.

MuJoCo opens that library when it is imported, and fails without it, though little of what Cadenza
does draws. `cadenza.sim.render` opens it anew, and says what is missing.
"""

import os

try:
    import mujoco
except Exception:  # PyOpenGL fails in many ways
    _library = os.environ["MUJOCO_GL"]
    os.environ["MUJOCO_GL"] = "off"
    try:
        import mujoco  # noqa: F401
    finally:
        os.environ["MUJOCO_GL"] = _library
