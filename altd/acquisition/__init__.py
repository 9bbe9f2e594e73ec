"""Control of cameras, lamps and the stage in threads and tasks: frames in, settings out."""
