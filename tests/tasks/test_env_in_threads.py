"""One environment used by several threads, and in a forked process."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap

import pytest

_BEGINNING = """
    import threading
    import numpy as np
    from cadenza.tasks.env import PianoVectorEnv

    envs = PianoVectorEnv("OdeToJoy", num_envs=2, num_threads=THREADS)
    envs.reset(seed=0)
    envs.step(np.zeros((2, 39)))
"""


def run(program: str, threads: int = 1) -> subprocess.CompletedProcess[str]:
    """Its own process: what goes wrong here ends or hangs it."""
    code = textwrap.dedent(_BEGINNING.replace("THREADS", str(threads))) + textwrap.dedent(program)
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("other", ["step(np.zeros((2, 39)))", "reset(seed=1)", "close()"])
def test_threads_that_share_an_environment_wait_for_each_other(other: str, threads: int) -> None:
    result = run(
        f"""
        failed = []

        def repeat(call):
            try:
                for _ in range(30):
                    call()
            except Exception as error:
                failed.append(error)

        calls = [lambda: envs.step(np.ones((2, 39))), lambda: envs.{other}] * 2
        workers = [threading.Thread(target=repeat, args=(call,)) for call in calls]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        print(set(map(str, failed)) - set(["the environment is closed: make another"]))
        """,
        threads,
    )
    assert (result.returncode, result.stdout) == (0, "set()\n"), result.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_forked_environment_steps_on() -> None:
    result = run(
        """
        import os

        held, let_go = threading.Event(), threading.Event()

        def hold(outcome):  # a step of the thread "holder", while the process forks
            if threading.current_thread().name == "holder":
                held.set()
                let_go.wait()
            return np.zeros(2)

        terms = {"hold": hold}
        envs = PianoVectorEnv("OdeToJoy", num_envs=2, num_threads=2, reward_terms=terms)
        envs.reset(seed=0)
        threading.Thread(target=lambda: envs.step(np.ones((2, 39))), name="holder").start()
        held.wait()
        child = os.fork()
        if child == 0:
            there = envs.step(np.ones((2, 39)))[0]
            os.write(1, there.tobytes().hex().encode() + b"\\n")
            os._exit(0)
        let_go.set()
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        os.write(1, envs.step(np.ones((2, 39)))[0].tobytes().hex().encode())
        """,
        threads=2,
    )
    assert result.returncode == 0
    in_child, in_parent = result.stdout.splitlines()
    assert in_child == in_parent


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_process_forked_during_a_step_steps_on() -> None:
    result = run(
        """
        import os, signal, time

        running = True

        def repeat():
            while running:
                envs.step(np.ones((2, 39)))

        threading.Thread(target=repeat).start()
        for _ in range(4):
            time.sleep(0.01)
            child = os.fork()
            if child == 0:
                signal.alarm(10)
                envs.step(np.ones((2, 39)))
                os._exit(0)
            print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
        running = False
        """,
        threads=2,
    )
    assert result.stdout.split() == ["0"] * 4, result.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_process_forked_after_rendering_says_that_it_cannot_render() -> None:
    result = run(
        """
        import os, signal
        from cadenza.errors import CadenzaError
        from cadenza.tasks.env import PianoEnv

        env = PianoEnv("OdeToJoy", render_mode="rgb_array")
        env.reset(seed=0)
        env.render()
        if os.fork() == 0:
            signal.alarm(20)
            try:
                env.render()
            except CadenzaError as error:
                os.write(1, str(error).encode())
            os._exit(0)
        os.wait()
        """
    )
    assert "start it with spawn" in result.stdout, result.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_process_forked_after_rendering_failed_says_why_it_cannot_render() -> None:
    result = run(
        """
        import os, signal
        from cadenza.errors import CadenzaError
        from cadenza.tasks.env import PianoEnv

        os.environ["MUJOCO_GL"] = "nothing"
        env = PianoEnv("OdeToJoy", render_mode="rgb_array")
        env.reset(seed=0)

        def try_to_render():
            try:
                env.render()
            except CadenzaError as error:
                os.write(1, str(error).encode() + b"\\n")

        try_to_render()
        if os.fork() == 0:
            signal.alarm(20)
            try_to_render()
            os._exit(0)
        os.wait()
        """
    )
    said = result.stdout.splitlines()
    assert len(said) == 2, result.stderr
    assert all("cannot render (nothing: " in line for line in said)


def test_every_thread_can_draw() -> None:
    result = run(
        """
        from cadenza.tasks.env import PianoEnv

        env = PianoEnv("OdeToJoy", render_mode="rgb_array")
        env.reset(seed=0)
        pictures = [env.render()]
        for _ in range(2):
            worker = threading.Thread(target=lambda: pictures.append(env.render()))
            worker.start()
            worker.join()
        pictures.append(env.render())
        print([bool((picture == pictures[0]).all()) for picture in pictures])
        """
    )
    assert result.stdout == "[True, True, True, True]\n", result.stderr
