"""TD3's update in NumPy, with gradients worked out by hand, and float64 throughout. Slow, and written to be read."""

import numpy as np


def actor(layers, inputs, half_range):
    """Return the actions, and what the backward pass needs."""
    seen, layer = [], inputs
    for weights, biases in layers[:-1]:
        seen.append(layer)
        layer = np.maximum(layer @ weights + biases, 0)
    seen.append(layer)
    weights, biases = layers[-1]
    squashed = np.tanh(layer @ weights + biases)
    return squashed * half_range, (seen, squashed)


def critic(layers, inputs, action):
    """Return the values, and the inputs of each layer."""
    seen, layer = [], inputs
    for weights, biases in layers[:-1]:
        seen.append(np.concatenate([layer, action], axis=1))
        layer = np.maximum(seen[-1] @ weights + biases, 0)
    seen.append(layer)
    weights, biases = layers[-1]
    return (layer @ weights + biases)[:, 0], seen


def critic_gradient(layers, seen, of_value, action_size):
    """Return the gradient by the layers and by the action, given that by the values."""
    gradients, of_action = [], 0.0
    of_layer = of_value[:, None]
    for i in reversed(range(len(layers))):
        gradients.insert(0, (seen[i].T @ of_layer, of_layer.sum(axis=0)))
        of_input = of_layer @ layers[i][0].T
        if i < len(layers) - 1:
            of_action = of_action + of_input[:, -action_size:]
            of_input = of_input[:, :-action_size]
        if i:
            of_layer = of_input * (seen[i][:, : of_input.shape[1]] > 0)
    return gradients, of_action


def actor_gradient(layers, kept, of_action, half_range):
    """Return the gradient by the layers, given that by the actions."""
    seen, squashed = kept
    gradients, of_layer = [], of_action * half_range * (1 - squashed**2)
    for i in reversed(range(len(layers))):
        gradients.insert(0, (seen[i].T @ of_layer, of_layer.sum(axis=0)))
        if i:
            of_layer = (of_layer @ layers[i][0].T) * (seen[i] > 0)
    return gradients


def mixed(function, *networks):
    """Return a network whose arrays are `function` of the arrays of others."""
    return tuple(tuple(map(function, *layers)) for layers in zip(*networks, strict=True))


class Adam:
    """Adam of Kingma and Ba 2015, algorithm 1."""

    def __init__(self, layers, learning_rate):
        self.rate, self.steps = learning_rate, 0
        self.means = self.squares = mixed(np.zeros_like, layers)

    def step(self, layers, gradients):
        self.steps += 1
        self.means = mixed(lambda mean, g: 0.9 * mean + 0.1 * g, self.means, gradients)
        self.squares = mixed(lambda square, g: 0.999 * square + 0.001 * g * g, self.squares, gradients)
        unbiased = 1 - 0.9**self.steps, 1 - 0.999**self.steps
        return mixed(
            lambda p, mean, square: p - self.rate * mean / unbiased[0] / (np.sqrt(square / unbiased[1]) + 1e-8),
            *(layers, self.means, self.squares),
        )


class TD3:
    """The networks of a level, updated one batch at a time."""

    def __init__(self, actor_layers, critics, own, half_range):
        self.own, self.half_range = own, np.array(half_range)
        self.unit = self.half_range if own.noise_unit == "range" else np.ones(len(half_range))
        self.actor, self.critics = actor_layers, list(critics)
        self.target_actor, self.target_critics = actor_layers, list(critics)
        self.adam = Adam(actor_layers, own.actor_learning_rate)
        self.critic_adams = [Adam(layers, own.critic_learning_rate) for layers in critics]
        self.updates = 0

    def target(self, batch):
        """Return r + discount * min(Q1', Q2') at the target actor's action with clipped noise."""
        noise = np.clip(batch["noise"] * 0.2 * self.unit, -0.5 * self.unit, 0.5 * self.unit)
        action = actor(self.target_actor, batch["next_inputs"], self.half_range)[0] + noise
        action = np.clip(action, -self.half_range, self.half_range)
        values = [critic(layers, batch["next_inputs"], action)[0] for layers in self.target_critics]
        return batch["reward"] + self.own.discount * batch["goes_on"] * np.minimum(*values)

    def update(self, batch):
        """Make an update; return the losses of critics and actor (NaN without one) and the mean target."""
        own, half_range, count, loss = self.own, self.half_range, len(batch["reward"]), 0.0
        aim = self.target(batch)
        for i, layers in enumerate(self.critics):
            values, seen = critic(layers, batch["inputs"], batch["action"])
            error = values - aim
            size = np.abs(error)
            loss += np.where(size <= 1, error**2 / 2, size - 0.5).mean()  # Huber
            of_value = np.clip(error, -1, 1) / count
            gradients, _ = critic_gradient(layers, seen, of_value, len(half_range))
            self.critics[i] = self.critic_adams[i].step(layers, gradients)
        self.updates += 1
        if self.updates % own.policy_delay:
            return loss, np.nan, aim.mean()
        action, kept = actor(self.actor, batch["inputs"], half_range)
        values, seen = critic(self.critics[0], batch["inputs"], action)
        _, of_action = critic_gradient(self.critics[0], seen, np.full(count, -1 / count), len(half_range))
        self.actor = self.adam.step(self.actor, actor_gradient(self.actor, kept, of_action, half_range))
        pairs = zip([self.target_actor, *self.target_critics], [self.actor, *self.critics], strict=True)
        self.target_actor, *self.target_critics = (
            mixed(lambda a, b: a + own.target_rate * (b - a), *pair) for pair in pairs
        )
        return loss, -values.mean(), aim.mean()
