"""Tables that programs of others load, one row an answer: JSON lines, CSV, Parquet; and a plot over time.

Names end in their unit, what is not known is absent, and every format has the same numbers.
"""
