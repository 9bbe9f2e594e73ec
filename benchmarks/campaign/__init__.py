"""A campaign against the measuring chain: light, frames and cameras spoilt, what is measured judged by truth.

Nobody imports it; ``python -m benchmarks.campaign`` (``make campaign``) runs it.
"""
