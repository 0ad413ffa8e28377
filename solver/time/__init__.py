"""Time integration: implicit steps through an impact, and exact free flight between impacts."""
