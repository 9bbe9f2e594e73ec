"""altd-recording/1: a folder of frames with their times (docs/recordings.md)."""
