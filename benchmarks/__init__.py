"""How fast the world and the learner are: `python -m benchmarks --out docs/benchmarks.md`."""
