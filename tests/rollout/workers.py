"""A worker for several designs at once: a few processes serve many runs. Worker processes import this module."""

from shes.envs.tasks.task_options import TaskOptions
from shes.rollout.worker import RolloutWorker, WorkerPlan
from tests.rollout.fake_task import FakeEnvironment


def fake_plan(design, table, *, goal_interval=0, horizon=10, chunk_size=0):
    """Return the plan of a worker on fake tasks."""
    return WorkerPlan(
        env=FakeEnvironment(goal_interval=goal_interval),
        training=TaskOptions(),
        evaluation=TaskOptions(evaluation=True),
        design=design,
        noise_table=table.path,
        horizon=horizon,
        evaluation_horizon=horizon,
        chunk_size=chunk_size,
    )


class AnyWorker:
    """Does what the one of its workers would do whose policies are as large as the generation's."""

    def __init__(self, plans):
        self.workers = {plan.design.dims: RolloutWorker(plan) for plan in plans}
        assert len(self.workers) == len(plans), "two designs have policies of the same sizes"
        for plan in plans:
            if plan.branch_design is not None:
                assert plan.branch_design.dims not in self.workers, "two designs have policies of the same sizes"
                self.workers[plan.branch_design.dims] = self.workers[plan.design.dims]

    def receive(self, generation):
        self.at_work = self.workers[tuple(len(level.theta) for level in generation.levels)]
        self.at_work.receive(generation)

    def run(self, work, share):
        return self.at_work.run(work, share)

    def close(self):
        for worker in self.workers.values():
            worker.close()
