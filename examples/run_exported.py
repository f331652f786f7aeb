"""Act with a policy from `shes export`, using only NumPy: `python run_exported.py policy.npz`.

docs/how-to/export.md documents the file. Vectors in the plane are complex numbers.
"""

import json
import sys

import numpy as np


def unit(angle):
    """Return the direction at `angle`."""
    return complex(np.cos(angle), np.sin(angle))


class ExportedAgent:
    """One robot's agent: `reset` when an episode begins, then `act` every step."""

    def __init__(self, path):
        self.arrays = dict(np.load(path))
        self.spec = json.loads(str(self.arrays["description"]))
        self.reset()

    def reset(self):
        self.step, self.goal, self.way, self.element = 0, 0j, 0j, 0

    def act(self, observation, pose=None, goal=None):
        """Return the controls in [-1, 1]; `pose` (x, y, heading) if the file has none, `goal` (x, y) of a primitive."""
        spec, seen, frame, features = self.spec, np.array(observation, np.float64), {}, []
        if "state_goals" in spec:
            features, seen = self.pursue(seen, pose)
        if "primitive" in spec:
            features, seen, frame = self.reach(seen, pose or pose_in(seen, **spec["pose"]), goal)
        clock = [2 * np.pi * rate["frequency_hz"] * rate["step_s"] * self.step for rate in spec["clock"]]
        sign = frame.get("clock_sign", 1)  # left and right legs take turns
        inputs = np.concatenate([features, sign * np.sin(clock), sign * np.cos(clock), seen])
        control = self.network(spec["levels"][-1], inputs) * np.float32(spec["control_limit"])
        if frame:
            control = control[frame["control_index"]] * np.array(frame["control_sign"], np.float32)
        self.step += 1
        return np.clip(control.astype(np.float64) / spec["control_limit"], -1, 1)

    def reach(self, seen, pose, goal):
        skill, scale = self.spec["primitive"], self.spec["scale"]
        position, heading = complex(*pose[:2]) / scale, pose[2]
        own, angle = view_of(seen, skill["view"], heading)
        if self.step % self.spec["controller_interval"] == 0:
            self.goal = position + self.decide(seen, heading) if "controller" in self.spec else complex(*goal) / scale
            self.way = self.goal - position
            way = self.way * unit(angle).conjugate()
            turn = np.arctan2(way.imag, way.real) * (skill["num_turns"] / (2 * np.pi))
            mirrored = skill["is_mirrored"] and turn < np.rint(turn)
            self.element = int(np.rint(turn)) % skill["num_turns"] + skill["num_turns"] * bool(mirrored)
        frame = skill["frames"][self.element]
        to = self.goal - position
        far = np.sqrt(to.real * to.real + to.imag * to.imag)
        if skill["view"]["kind"] == "egocentric":
            to, angle = to * unit(angle).conjugate(), 0.0
        to *= complex(frame["cosine"], -frame["sine"])
        to = complex(to.real, to.imag * frame["mirror"])
        turn = np.arctan2(to.imag, to.real) - angle
        features = {
            "angle": [np.sin(turn), np.cos(turn), far / 1000],
            "angle_metres": [np.sin(turn), np.cos(turn), far],
            "unit_vector": [to.real / (far or 1), to.imag / (far or 1), far / 1000],
            "vector": [to.real, to.imag],
        }
        turned = own[frame["view_index"]] * frame["view_sign"]
        if "view_matrix" in frame:
            turned = np.array(frame["view_matrix"]) @ own
        return features[skill["goal_encoding"]], turned, frame

    def pursue(self, seen, pose):
        """HIRO: the goal is a change of the robot's own coordinates."""
        goals = self.spec["state_goals"]
        at = np.array(pose[:2]) if goals["columns"] is None else seen[goals["columns"]]
        if self.step % self.spec["controller_interval"] == 0:
            self.goal = at + self.network("controller", seen) * np.array(goals["half_range"])
        return self.goal - at, seen[goals["view"]]

    def decide(self, seen, heading):
        boss = self.spec["controller"]
        last_goal = [self.way.real / boss["goal_distance_m"], self.way.imag / boss["goal_distance_m"]]
        values, _ = view_of(seen, boss["view"], heading, last_goal)
        out = self.network("controller", values).astype(np.float64)
        if boss["num_sectors"]:
            along = sectors_of(boss["num_sectors"]) * (2 / boss["num_sectors"])
            out = np.array([sum(out * along.real), sum(out * along.imag)])
        way = complex(*out[:2]) * unit(heading)
        out *= boss["goal_distance_m"]
        vectors = {
            "vector": complex(*out[:2]),
            "direction": complex(*out[:2]) / max(abs(complex(*out[:2])), 1e-9) * boss["goal_distance_m"],
            "heading_direction": way / max(abs(way), 1e-9) * boss["goal_distance_m"],
            "one_hot": max(out.max(), 1.0) * unit((out.argmax() + 1) * (np.pi / 4) - np.pi + heading),
        }
        to, least = vectors[boss["output"]], boss["min_component_m"]
        return complex(*(x if abs(x) >= least else -least if x < 0 else least for x in (to.real, to.imag)))

    def network(self, level, inputs):
        clip, last = self.spec["input_clip"] or np.inf, self.spec["num_layers"][level] - 1
        layer = np.clip((inputs - self.arrays[f"{level}/mean"]) * self.arrays[f"{level}/inverse_std"], -clip, clip)
        layer = layer.astype(np.float32)[None]
        for i in range(last + 1):
            layer = layer @ self.arrays[f"{level}/weights_{i}"] + self.arrays[f"{level}/biases_{i}"]
            is_relu = i < last and self.spec["hidden_activation"] == "relu"
            layer = np.maximum(layer, 0) if is_relu else np.tanh(layer)
        return layer[0]


def pose_in(seen, position, quaternion):
    """Return x, y and heading of the robot."""
    w, x, y, z = seen[quaternion] if quaternion else (1.0, 0.0, 0.0, 0.0)
    return *seen[position], np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)


def sectors_of(count):
    """Return the direction of the middle of each sector, counter-clockwise from straight behind."""
    middle = (np.arange(count) + 0.5) * (2 * np.pi / count) - np.pi
    return np.cos(middle) + 1j * np.sin(middle)


def view_of(seen, view, heading, last_goal=()):
    """Return what a level sees of the observation, and the angle of the frame in which it sees it."""
    columns = seen if view["columns"] is None else seen[view["columns"]]
    if view["kind"] == "columns":
        return columns, heading
    if view["kind"] == "sectors":
        seen = np.append(seen, last_goal)
        turned = [complex(*(seen[[x, y]] / scale)) * unit(heading).conjugate() for x, y, scale in view["vectors"]]
        along, rings = sectors_of(len(view["rings"][0])), seen[np.array(view["rings"])]
        parts = [vector.real * along.real + vector.imag * along.imag for vector in (1 + 0j, *turned)]
        return np.concatenate([*rings, *(((rings**2) ** 2) ** 2), *parts]), heading
    qpos, qvel = seen[view["qpos"]], seen[view["qvel"]]
    if view["body"] == "point":
        return np.concatenate([qpos[2:], qvel, columns]), 0.0
    if view["body"] not in ("ant", "free"):
        raise ValueError(f"no egocentric view of body {view['body']!r}; add it here. Known: ant, point, free")
    w, x, y, z = qpos[3:7]  # of the torso
    angle = 2 * np.arctan2(z, w)
    tilt = complex(2 * (x * z + w * y), 2 * (y * z - w * x)) * unit(angle).conjugate()
    speed = complex(*qvel[:2]) * unit(angle).conjugate()
    plane = [qpos[2], tilt.real, tilt.imag, speed.real, speed.imag]
    joints = qpos[7:] - view.get("home", 0.0)
    return np.concatenate([plane, qvel[2:6], joints, qvel[6:], columns]), angle


if __name__ == "__main__":
    agent = ExportedAgent(sys.argv[1] if len(sys.argv) > 1 else "policy.npz")
    size = len(agent.spec["observation"])
    controls = agent.act(np.zeros(size), pose=(0.0, 0.0, 0.0), goal=(1.0, 0.0))
    print(f"{agent.spec['env']}: {size} observed values become {len(controls)} controls")
