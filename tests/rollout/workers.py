"""A worker for several designs at once: a few processes serve many runs. Worker processes import this module."""

from shes.rollout.worker import RolloutWorker


class AnyWorker:
    """Does what the one of its workers would do whose policies are as large as the generation's."""

    def __init__(self, plans):
        self.workers = {}
        for plan in plans:
            worker = RolloutWorker(plan)
            for design in filter(None, (plan.design, plan.branch_design)):
                assert design.dims not in self.workers, "two designs have policies of the same sizes"
                self.workers[design.dims] = worker

    def receive(self, generation):
        self.at_work = self.workers[tuple(len(level.theta) for level in generation.levels)]
        self.at_work.receive(generation)

    def run(self, work, share):
        return self.at_work.run(work, share)

    def close(self):
        for worker in self.workers.values():
            worker.close()
