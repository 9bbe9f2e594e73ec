"""A campaign of disturbed light, frames and cameras against the measuring chain, judged by the truth.

It is not imported; ``python -m benchmarks.campaign`` (``make campaign``) runs it.
"""
