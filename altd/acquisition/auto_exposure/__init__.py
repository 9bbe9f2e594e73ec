"""What exposure and gain a camera should have next, and how it gets them."""
