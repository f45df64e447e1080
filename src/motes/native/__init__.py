"""Rank 3: the native engine for CPUs. Optional: without a compiler, or for what it cannot do, JAX does the work."""
