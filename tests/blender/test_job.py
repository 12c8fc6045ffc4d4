"""A job ends in exactly one way, and stops at its next report once it is cancelled."""

import threading

import pytest

from arm_blender.blender.job import Job
from arm_blender.errors import Cancelled, EmptyMeshError

PATIENCE = 10.0


def test_the_result_is_there_when_the_work_has_ended():
    job = Job(lambda progress: 6 * 7).start()
    assert job.join(PATIENCE)
    assert (job.result, job.error, job.failure) == (42, None, None)


def test_the_work_runs_on_another_thread():
    job = Job(lambda progress: threading.get_ident()).start()
    job.join(PATIENCE)
    assert job.result != threading.get_ident()


def test_only_the_newest_report_is_shown():
    def work(progress):
        for step in range(5):
            progress(step / 5, f"step {step}")

    job = Job(work).start()
    job.join(PATIENCE)
    assert job.latest() == (0.8, "step 4")
    assert job.latest() is None


def test_cancelling_stops_at_the_next_report():
    reached, may_go_on, after = threading.Event(), threading.Event(), []

    def work(progress):
        progress(0.1, "first")
        reached.set()
        assert may_go_on.wait(PATIENCE)
        progress(0.2, "second")
        after.append("went on")

    job = Job(work).start()
    assert reached.wait(PATIENCE)
    assert not job.finished
    job.cancel()
    may_go_on.set()
    assert job.join(PATIENCE)
    assert isinstance(job.error, Cancelled)
    assert job.result is None and not after


def test_a_users_error_and_a_bug_are_told_apart():
    def user_error(progress):
        raise EmptyMeshError("mug: no surface")

    def bug(progress):
        raise ValueError("shape (3, 4)")

    jobs = [Job(work).start() for work in (user_error, bug)]
    assert all(job.join(PATIENCE) for job in jobs)
    assert str(jobs[0].error) == "mug: no surface" and jobs[0].failure is None
    assert jobs[1].error is None and jobs[1].failure.endswith("ValueError: shape (3, 4)\n")


def test_a_job_that_was_not_started_has_not_finished():
    job = Job(lambda progress: None)
    assert not job.finished
    with pytest.raises(RuntimeError):
        job.join(0)
