"""Other people's planners, after what is published of them: what camrig is measured against. Pure.

None of their programs was available. Each module is our reimplementation and says what it had to assume. All are
judged by the same hard objective (``configuration``), whatever they minimise themselves.
"""
