"""Hostile inputs on HTTP, the WebSocket of the pictures, the local socket and the console, beside pollers."""
