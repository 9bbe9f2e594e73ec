"""Whether camera and target still stand to each other as they did when they were calibrated (thesis 3.4)."""
