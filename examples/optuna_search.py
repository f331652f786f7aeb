"""Search for good settings with Optuna (`pip install optuna`). A trial is a run, and its value is the best score."""

import optuna

import shes


def score(trial):
    """Return the score of a run with the settings of `trial`."""
    run = shes.train(
        "point-gather",
        preset="smoke",
        seed=trial.number,
        generations=4,
        num_workers=1,
        sigma=trial.suggest_float("sigma", 0.01, 0.2, log=True),
        learning_rate=trial.suggest_float("learning_rate", 0.002, 0.1, log=True),
    )
    return run.best.score


if __name__ == "__main__":
    study = optuna.create_study(direction="maximize")
    study.optimize(score, n_trials=2)
    print(f"the best of {len(study.trials)} runs has sigma={study.best_params['sigma']:.3f}")
