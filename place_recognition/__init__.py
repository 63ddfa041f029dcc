"""Have I been here before? The chapter's Figure 4.2, folder by folder: images, map, belief, paradigms."""
