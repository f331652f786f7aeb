"""Evolution strategies as the papers write them: loops, float64, one entry per member of the population.

Written from Salimans et al. 2017 (Algorithm 2), the SHES paper (Algorithm 1, II-E, II-F) and Kingma and Ba 2014.
Nothing is grouped: every member has its own noise vector and its own sign, and the sum runs over all members that
perturb the level.
"""

import math

SIGNS = {
    ("quad", 1): [(+1,), (-1,)],
    ("pair", 1): [(+1,), (-1,)],
    ("none", 1): [(+1,)],
    ("quad", 2): [(+1, +1), (+1, -1), (-1, +1), (-1, -1)],
    ("pair", 2): [(+1, +1), (-1, -1)],
    ("none", 2): [(+1, +1)],
}


def group_signs(mirrored, perturbation, learns, num_groups, generation):
    """Return the signs of every member of every group at each level [G][M][L]; 0 for a level that is left alone."""
    learning = [level for level, is_learning in enumerate(learns) if is_learning]
    if perturbation == "many_to_many":
        perturbed = [learning] * num_groups
    elif perturbation == "one_to_many":
        perturbed = [[learning[generation % len(learning)]]] * num_groups
    else:
        perturbed = [[learning[group // (num_groups // len(learning))]] for group in range(num_groups)]
    return [
        [
            tuple(signs[levels.index(level)] if level in levels else 0 for level in range(len(learns)))
            for signs in SIGNS[mirrored, len(levels)]
        ]
        for levels in perturbed
    ]


def centred_ranks(fitness, ties):
    """Return the rank of every member, from -0.5 (worst) to 0.5 (best), by counting whom it beats."""
    shaped = []
    for i, mine in enumerate(fitness):
        rank = 0.0
        for j, other in enumerate(fitness):
            if other < mine:
                rank += 1
            elif other == mine and j != i:
                if ties == "average":
                    rank += 0.5
                elif j < i:
                    rank += 1
        shaped.append(rank / (len(fitness) - 1) - 0.5)
    return shaped


class Adam:
    """Kingma and Ba's Algorithm 1, uphill, with its last three lines replaced as the end of their section 2 says.

    The two differ only in what epsilon is added to: here to sqrt(v), there to sqrt(v^), which is up to 32 times larger.
    """

    def __init__(self, dim):
        self.m, self.v, self.t = [0.0] * dim, [0.0] * dim, 0

    def step(self, gradient, rate, beta1=0.9, beta2=0.999, epsilon=1e-8):
        self.t += 1
        alpha_t = rate * math.sqrt(1 - beta2**self.t) / (1 - beta1**self.t)
        step = []
        for d, g in enumerate(gradient):
            self.m[d] = beta1 * self.m[d] + (1 - beta1) * g
            self.v[d] = beta2 * self.v[d] + (1 - beta2) * g * g
            step.append(alpha_t * self.m[d] / (math.sqrt(self.v[d]) + epsilon))
        return step


class TextbookES:
    """One or two levels, each with its own fitness, gradient and Adam. A level that nobody perturbed rests."""

    def __init__(
        self, thetas, *, mirrored, sigma, rate, weight_decay=0.0, ties="average", perturbation="many_to_many",
        learns=(True, True),
    ):  # fmt: skip
        self.thetas = [[float(x) for x in theta] for theta in thetas]
        self.adams = [Adam(len(theta)) for theta in thetas]
        self.sigma, self.rate, self.weight_decay, self.ties = sigma, rate, weight_decay, ties
        self.mirrored, self.perturbation, self.generation = mirrored, perturbation, 0
        self.learns = learns[: len(thetas)]

    def members(self, noise):
        """Return (sign, noise vector) of every member at every level: [n][L], from `noise` [L][G][D]."""
        groups = group_signs(self.mirrored, self.perturbation, self.learns, len(noise[0]), self.generation)
        return [
            [(sign, noise[level][group]) for level, sign in enumerate(signs)]
            for group, members in enumerate(groups)
            for signs in members
        ]

    def candidates(self, noise):
        """Return the parameters of every member at every level [n][L][D]."""
        return [
            [
                [t + self.sigma * sign * float(e) for t, e in zip(theta, epsilon, strict=True)]
                for theta, (sign, epsilon) in zip(self.thetas, member, strict=True)
            ]
            for member in self.members(noise)
        ]

    def update(self, fitness, noise):
        """Take one step from `fitness` [L][n] of the members that `noise` makes, by their ranks."""
        members = self.members(noise)
        for level, theta in enumerate(self.thetas):
            own = [(f, *member[level]) for f, member in zip(fitness[level], members, strict=True) if member[level][0]]
            if not own:
                continue
            gradient = [-self.weight_decay * t for t in theta]
            shaped = centred_ranks([f for f, _, _ in own], self.ties)
            for worth, (_, sign, epsilon) in zip(shaped, own, strict=True):
                for d in range(len(theta)):
                    gradient[d] += worth * sign * float(epsilon[d]) / len(own)
            step = self.adams[level].step(gradient, self.rate)
            self.thetas[level] = [t + s for t, s in zip(theta, step, strict=True)]
        self.generation += 1
