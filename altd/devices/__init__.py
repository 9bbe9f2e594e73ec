"""Device drivers that implement the ports."""
