"""A Warp simulator that finds contacts and joint limits in another order in every substep, as a GPU may."""

import dataclasses

import warp as wp

from shes.sim.warp import WarpSimulator


@wp.kernel(enable_backward=False)
def shuffle(values: wp.array2d[wp.int32], count: wp.array[wp.int32], seed: wp.int32, time: wp.array[wp.float32]):
    """Shuffle the first `count` rows, each array with the same seed and time in the same way."""
    random = wp.rand_init(seed, wp.int32(time[0] * 1e4))
    size = wp.min(count[0], values.shape[0])
    for i in range(size - 1):
        j = wp.randi(random, i, size)
        for column in range(values.shape[1]):
            kept = values[i, column]
            values[i, column] = values[j, column]
            values[j, column] = kept


class DisorderedSimulator(WarpSimulator):
    def __init__(self, model, num_sims, seed, deterministic):
        self.seed = seed
        self.num_limits = wp.array([int(model.jnt_limited.sum())], dtype=wp.int32, device="cpu")
        super().__init__(model, num_sims, "warp-cpu", deterministic=deterministic)

    def align_tangents(self, model, data):
        super().align_tangents(model, data)
        arrays = [(getattr(data.contact, field.name), data.nacon) for field in dataclasses.fields(data.contact)]
        arrays = [(array, count) for array, count in arrays if array.shape == (data.naconmax,)]
        for array, count in [*arrays, (model.jnt_limited_slide_hinge_adr, self.num_limits)]:
            shape = (*array.shape, wp.types.type_size_in_bytes(array.dtype) // 4)
            values = wp.array(ptr=array.ptr, dtype=wp.int32, shape=shape, device="cpu")
            wp.launch(shuffle, dim=1, inputs=[values, count, self.seed, data.time])

    def contacts_and_their_rows(self):
        """Return the contacts that have rows, and the contacts to which the rows at their addresses belong."""
        data, count = self._data, int(self._data.nacon.numpy()[0])
        rows, sims = data.contact.efc_address.numpy()[:count, 0], data.contact.worldid.numpy()[:count]
        (contacts,) = (rows >= 0).nonzero()
        return contacts.tolist(), data.efc.id.numpy()[sims[contacts], rows[contacts]].tolist()
