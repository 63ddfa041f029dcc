"""Files in the field's own formats, written beside and renamed, never half."""
