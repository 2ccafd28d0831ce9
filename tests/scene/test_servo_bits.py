"""What servos do to joints, to the last bit."""

from numpy.testing import assert_array_equal
from threadpoolctl import threadpool_limits

from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import Servos, servos_of


def test_coordinates_of_joints_do_not_depend_on_the_threads_of_linear_algebra():
    servos = servos_of(build_scene(SceneConfig(reduced_action_space=False)))
    maps = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            fresh = Servos(**{name: getattr(servos, name) for name in servos.__dataclass_fields__})
            maps.append(fresh.of_joints)
    assert_array_equal(*maps)
