"""What needs numba: how a kernel is compiled, and where its code is kept."""

import numba as numba  # before the modules here: kernels that wait for it (`skd_sim.kernels.waiting`) need them all
