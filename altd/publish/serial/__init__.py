"""Serial ports: the telegram for a controller and the console for a technician."""
