"""Pictures and pages that show one run."""
