"""The real-time flow on asyncio: cameras, measuring chain, board, health, supervision."""
