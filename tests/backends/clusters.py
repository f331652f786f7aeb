"""Ray clusters for tests: several nodes on this machine."""

from contextlib import contextmanager

import pytest

NODE = {"num_cpus": 1, "object_store_memory": 200_000_000}


@contextmanager
def ray_cluster(num_nodes, num_cpus=1):
    """Start a cluster, which this process joins. Its first node has `num_cpus` CPUs, the others one.

    Node i has its name, i, in SHES_TEST_NODE.
    """
    import ray
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "disabled")  # no token in the user's home
        patch.setenv("SHES_TEST_NODE", "0")
        head = {**NODE, "num_cpus": num_cpus, "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=head)
        try:
            for i in range(1, num_nodes):
                add_node(cluster, i)
            ray.init(address=cluster.address, log_to_driver=False)
            yield cluster
        finally:
            ray.shutdown()
            cluster.shutdown()


def add_node(cluster, name, **environment):
    """Add a node to a cluster; return it."""
    return cluster.add_node(**NODE, env_vars={"SHES_TEST_NODE": str(name), **environment})
