"""The world in the terms of other people's tools: Gymnasium and PettingZoo, each an optional extra.

Nothing is imported here: `murmurate.adapters.gymnasium` and `murmurate.adapters.pettingzoo` load what they adapt to.
"""
