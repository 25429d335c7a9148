"""Broken files for every reader, from a seed. A reader must return a valid object or end with an error of one line.

mutations   how a file is broken
readers     each reader with files that it reads, and what must hold of what it returns
hostile_page   what a hostile page sends, while an honest one wants answers
examine     one case: no traceback, no hang, bounded memory, nothing left behind, and no wrong content accepted
"""
