"""Pages made as Markdown, shown as HTML."""

from __future__ import annotations

from camber.validation.markdown import sections_as_html, table


def test_headings_begin_sections_and_tables_keep_their_cells() -> None:
    blocks = ("## The lab", "    camber lab", "text of *one* and `two`", table(("a", "b"), [("1", "**no**")]))
    assert sections_as_html("\n\n".join(blocks)) == (
        "<section>\n<h2>The lab</h2>\n<pre>camber lab</pre>\n<p>text of <em>one</em> and <code>two</code></p>\n"
        '<div class="scroll"><table><thead><tr><th>a</th><th>b</th></tr></thead>'
        "<tbody><tr><td>1</td><td><strong>no</strong></td></tr></tbody></table></div>\n</section>\n"
    )


def test_text_of_figures_does_not_become_html() -> None:
    html = sections_as_html("## <b>\n\n" + table(("<i>",), [("<script>",)]))
    assert "<b>" not in html
    assert "<i>" not in html
    assert "<script>" not in html
