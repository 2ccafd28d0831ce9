"""What has been learnt about plans: networks that correct them, and what they are told."""
