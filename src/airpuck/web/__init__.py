"""Pages in the browser, their server, and the game in real time.

Entry points: `session.play_in_browser`, `match_page.watch_in_browser`, `view.view_live`.
"""
