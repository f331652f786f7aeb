"""A second implementation of the agents: one robot, Python's floats, a step at a time, as the documentation has it."""

import math

import numpy as np

from shes.agents.goals import CONTROLLER_OUTPUTS, GOAL_ENCODINGS
from shes.agents.rewards import PRIMITIVE_REWARDS


def encode(name, vector, heading):
    """Return the features of a goal at `vector` by the name of the encoding."""
    x, y = vector
    distance = math.hypot(x, y)
    ahead = complex(x, y) * complex(math.cos(heading), -math.sin(heading))  # as the robot sees it
    seen = ahead / abs(ahead) if distance else complex(math.cos(heading), -math.sin(heading))
    return {
        "angle": [seen.imag, seen.real, distance / 1000],
        "angle_metres": [seen.imag, seen.real, distance],
        "unit_vector": [x / (distance or 1), y / (distance or 1), distance / 1000],
        "vector": [x, y],
    }[name]


def decide(name, output, heading, goal_distance):
    """Return the vector to the goal that an `output` of the controller means by the name of its kind."""
    if name == "one_hot":
        best = max(range(8), key=lambda i: (output[i], -i))
        angle = math.radians((-135, -90, -45, 0, 45, 90, 135, 180)[best]) + heading
        distance = max(output[best] * goal_distance, 1)
        return distance * math.cos(angle), distance * math.sin(angle)
    vector = complex(*output)
    if name.endswith("direction"):
        vector /= abs(vector) or 1
    if name.startswith("heading"):
        vector *= complex(math.cos(heading), math.sin(heading))
    return vector.real * goal_distance, vector.imag * goal_distance


def pay(name, left, before, moved, way):
    """Return the reward of a step that began `before` metres from the goal and ended `left` from it.

    Since the goal was set the robot has `moved`; the goal was at `way` then. Both are vectors.
    """
    moved, way = complex(*moved), complex(*way)
    cosine = moved / (abs(moved) or 1) * (way / (abs(way) or 1)).conjugate()
    return {
        "progress": 1 - left / max(abs(way), 1e-3) + (1 if left < 1 else 0),
        "metres": 4 * (before - left) + (0.2 if left < 1 else 0),
        "negative_distance": -left,
        "cosine": cosine.real,
    }[name]


def push_outward(vector):
    """Return `vector` with both components at least sqrt(1/2) from 0, to the positive side if it is 0."""
    return [math.copysign(max(abs(x), math.sqrt(0.5)), x or 1.0) for x in vector]


def network(mlp, theta, inputs, activate=np.tanh):
    """Return the outputs of a network with `theta`, weights and biases layer by layer."""
    x, rest = np.asarray(inputs, float), np.asarray(theta, float)
    for fan_in, fan_out in zip(mlp.sizes, mlp.sizes[1:], strict=False):
        weights, biases, rest = np.split(rest, [fan_in * fan_out, (fan_in + 1) * fan_out])
        x = x @ weights.reshape(fan_in, fan_out) + biases
        x = activate(x) if len(rest) else np.tanh(x)
    return x


def outputs(mlp, theta, seen):
    """Return the outputs [P, R, A] of `mlp` itself for policies `theta` [P, D] and inputs `seen` [P, R, O]."""
    return mlp.forward(mlp.layers(mlp.expand(theta)), seen)


def columns(view, observation, heading):
    """Return what a view of columns shows, and the heading in which it does."""
    return list(observation if view.indices is None else observation[list(view.indices)]), heading


def rotated(vector, angle):
    """Return `vector` turned counter-clockwise."""
    turned = complex(*vector) * complex(math.cos(angle), math.sin(angle))
    return np.array([turned.real, turned.imag])


def element_as_matrices(group, element):
    """Return what an element of a body's group makes of a view [V, V], a vector [2, 2] and controls [A, A]."""
    matrices = []
    for index, sign in ((group.view_index, group.view_sign), (group.control_index, group.control_sign)):
        matrix = np.zeros((index.shape[1],) * 2)
        matrix[range(len(matrix)), index[element]] = sign[element]
        matrices.append(matrix)
    cosine, sine, mirror = (each[element] for each in group.direction())
    return matrices[0], np.array([[cosine, sine], [-mirror * sine, mirror * cosine]]), matrices[1]


def _name(registry, made):
    return {of: name for name, of in registry.items()}[type(made)]


class PlainAgent:
    """An agent of `design` for one robot; `see` is what a view makes of an observation."""

    def __init__(self, design, thetas, levels, recorded=(), see=columns):
        self.design, self.thetas, self.levels, self.recorded, self.see = design, thetas, levels, list(recorded), see
        self.has_goals = "primitive" in design.networks
        if self.has_goals:
            self.encoding = _name(GOAL_ENCODINGS, design.goal_encoding)
            self.reward = _name(PRIMITIVE_REWARDS, design.primitive_reward)
        self.clock, self.goals_reached, self.element, self.way = 0, 0, None, (0.0, 0.0)
        self.inputs = [[] for _ in levels]
        """What each level has seen so far."""

    def act(self, observation, position, heading, goal=None, decision_noise=0.0, control_noise=0.0):
        """Return the controls of a step."""
        design = self.design
        if not self.has_goals:
            seen, features, turn = observation, [], None
        else:
            seen, frame = self.see(design.primitive_view, observation, heading)
            if self.clock % design.controller_interval == 0:
                self._set_goal(observation, position, heading, goal, decision_noise)
                if design.symmetry is not None:
                    ahead, left = rotated(self.way, -frame)
                    self.element = int(design.symmetry.choose(np.array([ahead]), np.array([left]))[0])
            vector = self.goal - position
            if design.primitive_view.is_egocentric:
                vector, frame = rotated(vector, -frame), 0.0
            if self.element is not None:
                view, direction, turn = element_as_matrices(design.symmetry, self.element)
                seen, vector = view @ seen, direction @ vector
            features = encode(self.encoding, vector, frame)
        if design.clock is not None:
            phase = 2 * math.pi * design.clock.frequency_hz * design.clock.step_s * self.clock
            features = [*features, math.sin(phase), math.cos(phase)]
        self.clock += 1
        control = self._output(-1, [*features, *seen]) * design.control_limit + control_noise
        return control if self.element is None else turn @ control

    def _set_goal(self, observation, position, heading, goal, noise):
        own = self.design
        if own.controller_view is not None:
            seen = observation
            if own.controller_view.sees_last_goal:
                seen = np.append(observation, np.array(self.way) / own.goal_distance)
            output = self._output(0, self.see(own.controller_view, seen, heading)[0]) + noise
            vector = decide(
                _name(CONTROLLER_OUTPUTS, own.controller_output), output.tolist(), heading, own.goal_distance
            )
            goal = position + np.array(push_outward(vector) if own.has_minimum_goal_distance else vector)
        elif self.recorded:
            goal = position + (self.recorded.pop(0) if len(self.recorded) > 1 else self.recorded[0])
        self.goal, self.origin, self.way = np.array(goal), np.array(position), goal - position
        self.distance, self.is_reached = math.hypot(*self.way), False

    def _output(self, level, inputs):
        parameters = self.levels[level]
        self.inputs[level].append(np.array(inputs))
        scaled = np.clip((np.array(inputs) - parameters.mean) * parameters.inverse_std, -5, 5)
        return network(self.design.policies[level], self.thetas[level], scaled)

    def pay(self, position):
        """Return the reward of moving to `position`, and count the goals reached."""
        if not self.has_goals:
            return 0.0
        before, self.distance = self.distance, math.dist(self.goal, position)
        self.goals_reached += self.distance < 1 and not self.is_reached
        self.is_reached |= self.distance < 1
        return pay(self.reward, self.distance, before, position - self.origin, self.way)
