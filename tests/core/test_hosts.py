"""What launchers tell their processes, as each sets it, and what is said where something is missing."""

import pytest

import motes as mo
from data import refused
from motes.core.hosts import PORTS, launched

SLURM = {"SLURM_JOB_ID": "8191", "SLURM_STEP_ID": "0", "SLURM_NTASKS": "4", "SLURM_PROCID": "3", "SLURM_LOCALID": "1",
         "SLURM_STEP_NODELIST": "node[007-009,12],gpu2"}  # fmt: skip
TORCH = {"RANK": "1", "WORLD_SIZE": "2", "MASTER_ADDR": "10.0.0.5", "MASTER_PORT": "29500", "LOCAL_RANK": "0"}
FOUR = {"OMPI_MCA_orte_hnp_uri": "1531576320.0;tcp://10.96.0.1,10.148.0.1:34911", "OMPI_COMM_WORLD_SIZE": "8", "OMPI_COMM_WORLD_RANK": "5",
        "PMIX_NAMESPACE": "1531576320"}  # fmt: skip
FIVE = {"PMIX_NAMESPACE": "prterun-node-01-2211@1", "OMPI_COMM_WORLD_SIZE": "2", "OMPI_COMM_WORLD_RANK": "0"}
HAND = {"JAX_COORDINATOR_ADDRESS": "here:1234", "JAX_NUM_PROCESSES": "3", "JAX_PROCESS_ID": "2"}
POD = {"JOB_COMPLETION_INDEX": "1", "JAX_COORDINATOR_ADDRESS": "job-0.service:1234", "JAX_NUM_PROCESSES": "2"}


@pytest.mark.parametrize(("told", "launcher", "host", "port", "count", "number"), [
    (SLURM, "Slurm", "node007", PORTS[4095], 4, 3),
    (SLURM | {"SLURM_STEP_NODELIST": "alone"}, "Slurm", "alone", PORTS[4095], 4, 3),
    (SLURM | {"SLURM_STEP_NODELIST": "one,two[1-3]", "SLURM_STEP_ID": "1"}, "Slurm", "one", PORTS[976], 4, 3),
    (TORCH, "torchrun", "10.0.0.5", 29500, 2, 1),
    (TORCH | SLURM | {"TORCHELASTIC_RUN_ID": "none"}, "torchrun", "10.0.0.5", 29501, 2, 1),
    (FOUR | SLURM, "Open MPI", "10.96.0.1", PORTS[1531576320 // 4096 % 4096], 8, 5),
    (FOUR | {"OMPI_MCA_orte_hnp_uri": "4096.0;tcp6://[fe80::1,2620::2]:43370"}, "Open MPI", "[fe80::1]", PORTS[1], 8, 5),
    (FIVE | SLURM, "Open MPI 5", "node-01", PORTS[2211 + 977], 2, 0),
    (SLURM | {"JAX_COORDINATOR_ADDRESS": "login:7"}, "Slurm", "login", 7, 4, 3),
    (HAND | SLURM | TORCH, "a start by hand", "here", 1234, 3, 2),
    (POD, "Kubernetes", "job-0.service", 1234, 2, 1),
])  # fmt: skip
def test_each_launcher_is_known_by_what_it_tells(told, launcher, host, port, count, number):
    assert launched(told) == (launcher, f"{host}:{port}", count, number)


@pytest.mark.parametrize(("told", "words"), [
    ({}, ("started by srun, mpirun or torchrun", "JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID", "--processes 2")),
    ({name: SLURM[name] for name in SLURM if "STEP" not in name}, ("variables of Slurm", "SLURM_STEP_NODELIST and SLURM_STEP_ID", "srun")),
    ({name: TORCH[name] for name in TORCH if name != "MASTER_PORT"}, ("torchrun", "none by the name of MASTER_PORT")),
    ({name: HAND[name] for name in HAND if name != "JAX_PROCESS_ID"}, ("none by the name of JAX_PROCESS_ID",)),
    ({name: HAND[name] for name in HAND if name != "JAX_NUM_PROCESSES"}, ("none by the name of JAX_NUM_PROCESSES",)),
    ({"JOB_COMPLETION_INDEX": "1"}, ("Kubernetes", "JAX_NUM_PROCESSES and JAX_COORDINATOR_ADDRESS")),
    (FIVE | {"PMIX_NAMESPACE": "odd"}, ("an address from the variables of Open MPI 5", "PMIX_NAMESPACE='odd'")),
    (FOUR | {"OMPI_MCA_orte_hnp_uri": "x"}, ("an address from the variables of Open MPI",)),
    (SLURM | {"SLURM_PROCID": "one"}, ("SLURM_PROCID: expected a whole number, got 'one'",)),
    (HAND | {"JAX_PROCESS_ID": "3"}, ("from 0 to below the number of processes, got 3 of 3",)),
    (HAND | {"JAX_COORDINATOR_ADDRESS": "nowhere"}, ("HOST:PORT, got 'nowhere'",)),
])  # fmt: skip
def test_what_is_missing_is_named(told, words):
    with pytest.raises(mo.MotesError) as error:
        launched(told)
    refused(error, "join", *words)


def test_one_process_needs_nobody_and_bad_arguments_are_refused():
    assert mo.join("here:1", 1, 0) == ("a start by hand", "here:1", 1, 0)
    for bad in ({"heartbeat": 0}, {"patience": 1.5}):
        with pytest.raises(mo.MotesError, match=f"join {next(iter(bad))}: expected a whole number of at least 1"):
            mo.join("here:1", 1, 0, **bad)


def test_it_is_called_before_anything_is_computed():
    import jax

    jax.devices()
    with pytest.raises(mo.MotesError) as error:
        mo.join("127.0.0.1:1234", 2, 0)
    refused(error, "join: expected 2 processes that find 127.0.0.1:1234", "before anything is computed")
