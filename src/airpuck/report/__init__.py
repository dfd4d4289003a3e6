"""Pages, tables, figures and animations; the only package that imports matplotlib.

Entry points: `animation.animate`, `evaluation_report.evaluation_report`,
`fit_report.fit_report`, `page.write_page`, `reproduce.reproduce`, `reproduce.demo`.
"""
