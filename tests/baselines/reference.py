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


def target(batch, target_actor, target_critics, half_range, unit, discount):
    """Return r + discount * min(Q1', Q2') at the target actor's action with clipped noise."""
    noise = np.clip(batch["noise"] * 0.2 * unit, -0.5 * unit, 0.5 * unit)
    action = np.clip(actor(target_actor, batch["next_inputs"], half_range)[0] + noise, -half_range, half_range)
    values = [critic(layers, batch["next_inputs"], action)[0] for layers in target_critics]
    return batch["reward"] + discount * batch["goes_on"] * np.minimum(*values)


class Adam:
    """Adam of Kingma and Ba 2015, algorithm 1."""

    def __init__(self, layers, learning_rate):
        self.rate, self.steps = learning_rate, 0
        self.moments = [[(np.zeros_like(p), np.zeros_like(p)) for p in layer] for layer in layers]

    def step(self, layers, gradients):
        self.steps += 1
        stepped = []
        for i, (layer, gradient) in enumerate(zip(layers, gradients, strict=True)):
            new = []
            for j, (p, g) in enumerate(zip(layer, gradient, strict=True)):
                mean, square = self.moments[i][j]
                mean, square = 0.9 * mean + 0.1 * g, 0.999 * square + 0.001 * g * g
                self.moments[i][j] = mean, square
                unbiased = mean / (1 - 0.9**self.steps), square / (1 - 0.999**self.steps)
                new.append(p - self.rate * unbiased[0] / (np.sqrt(unbiased[1]) + 1e-8))
            stepped.append(tuple(new))
        return stepped


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

    def update(self, batch):
        """Make an update; return the losses of critics and actor (NaN without one) and the mean target."""
        own, half_range, count, loss = self.own, self.half_range, len(batch["reward"]), 0.0
        aim = target(batch, self.target_actor, self.target_critics, half_range, self.unit, own.discount)
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
        self.target_actor = self._moved(self.target_actor, self.actor)
        self.target_critics = [self._moved(*pair) for pair in zip(self.target_critics, self.critics, strict=True)]
        return loss, -values.mean(), aim.mean()

    def _moved(self, old, new):
        rate = self.own.target_rate
        return [
            tuple(a + rate * (b - a) for a, b in zip(*layers, strict=True)) for layers in zip(old, new, strict=True)
        ]
