"""MQTT: summaries or measurements, the unit's state and identity, published to a broker."""
