"""The world in the terms of other people's tools: Gymnasium and PettingZoo, each an optional extra.

Nothing is imported here: `murmurate.interop.gymnasium` and `murmurate.interop.pettingzoo` load what they adapt to.
"""
