"""Many runs: what a sweep asks for, who trains it (this machine, Ray or Slurm), and the table that comes of it.

Nothing is imported here: a worker says how many threads it may use before JAX is loaded.
"""
