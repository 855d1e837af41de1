"""A report that is written once and comes out as Markdown and as HTML.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import html
import os

from programs import markdown

STYLE = """body { font: 16px/1.5 system-ui, sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em;
       color: #222; }
table { border-collapse: collapse; margin: 1em 0; font-size: 14px; font-variant-numeric: tabular-nums; }
td, th { padding: 2px 10px; border-bottom: 1px solid #ddd; text-align: right; }
td:first-child, th:first-child { text-align: left; }
img { max-width: 100%; } figure { margin: 1em 0; } figcaption { font-size: 14px; color: #555; }"""


class Page:
    """Text grows in both forms at once; save() writes NAME.md and NAME.html beside the pictures' folder."""

    def __init__(self, title):
        self.title = title
        self.md = [f"# {title}\n"]
        self.body = [f"<h1>{html.escape(title)}</h1>"]

    def heading(self, text):
        self.md.append(f"## {text}\n")
        self.body.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text):
        """One paragraph; its line breaks don't count."""
        text = " ".join(text.split())
        self.md.append(text + "\n")
        self.body.append(f"<p>{html.escape(text)}</p>")

    def table(self, header, rows):
        self.md.append(markdown(header, rows) + "\n")
        lines = ["<table>", "<tr>" + "".join(f"<th>{html.escape(cell)}</th>" for cell in header) + "</tr>"]
        lines += ["<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows]
        self.body.append("\n".join([*lines, "</table>"]))

    def picture(self, path, caption):
        self.md.append(f"![{caption}]({path})\n")
        self.body.append(f'<figure><img src="{html.escape(str(path))}" alt="{html.escape(caption)}">'
                         f"<figcaption>{html.escape(caption)}</figcaption></figure>")

    def save(self, stem):
        os.makedirs(os.path.dirname(stem) or ".", exist_ok=True)
        with open(f"{stem}.md", "w", encoding="utf-8") as file:
            file.write("\n".join(self.md))
        with open(f"{stem}.html", "w", encoding="utf-8") as file:
            file.write(f'<!doctype html>\n<html lang="en"><meta charset="utf-8">\n'
                       f"<title>{html.escape(self.title)}</title>\n<style>{STYLE}</style>\n" +
                       "\n".join([*self.body, "</html>\n"]))
