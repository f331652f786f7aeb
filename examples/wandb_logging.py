"""Log a run to Weights & Biases: `pip install wandb`. Without an account, set WANDB_MODE=offline."""

import wandb

import shes


class WandbListener:
    """Sends every row of the tables to Weights & Biases."""

    def on_start(self, path, config, generation, num_workers):
        self.run = wandb.init(project="shes", name=path.name, config=config.values)

    def on_generation(self, row):
        self.run.log({f"training/{name}": value for name, value in row.items()}, step=row["generation"])

    def on_evaluation(self, row):
        self.run.log({f"evaluation/{name}": value for name, value in row.items()}, step=row["generation"])

    on_event = staticmethod(print)


if __name__ == "__main__":
    run = shes.train("point-gather", preset="smoke", generations=4, num_workers=1, listener=WandbListener())
    print(f"logged {run.generation} generations")
