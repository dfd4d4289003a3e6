"""Pages in the browser, and their server.

Entry points: `view.view_live`.
"""
