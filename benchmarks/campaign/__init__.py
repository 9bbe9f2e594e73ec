"""A campaign against the measuring chain: disturbed light, frames and cameras; the truth judges the results.

It is not imported; ``python -m benchmarks.campaign`` (``make campaign``) runs it.
"""
