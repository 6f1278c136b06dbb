"""The paper's tables and ours, re-runnable by anyone."""
