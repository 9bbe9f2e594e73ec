"""A campaign against the measuring chain: light, frames and cameras spoilt in many ways, judged against truth.

Nobody imports it; ``python -m benchmarks.campaign`` (``make campaign``) runs it.
"""
