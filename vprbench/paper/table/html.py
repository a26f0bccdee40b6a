"""Table II as a fragment of HTML."""

from __future__ import annotations

import jinja2

from vprbench.paper.table import words
from vprbench.paper.table.cells import Table

_TEMPLATE = """\
{% macro shown(text, quoted) %}
{% if text == layout.INAPPLICABLE %}<abbr title="not applicable">{{ text }}</abbr>
{%- elif quoted %}<i>{{ text }}</i>
{%- else %}{{ text }}{% endif %}
{% endmacro %}

{% macro marks(words) %}
<sup>
{%- if words.machine %}<a href="#table-machine-{{ words.machine }}">{{ layout.machine_mark(words.machine) }}</a>
{{- ", " if words.notes }}{% endif %}
{%- for note in words.notes %}<a href="#table-note-{{ note }}">{{ note }}</a>{{ ", " if not loop.last }}{% endfor %}
</sup>
{%- endmacro %}

{% macro cell(words, in_paper) %}
<td class="{{ words.kind }}">
{%- if words.absence %}{{ shown(words.absence, false) }}{{ " " if words.value }}{% endif %}
{%- if words.best %}<b class="best">{{ words.value }}</b>
{%- else %}{{ shown(words.value, words.kind == "quoted") if words.value }}{% endif %}
{%- if words.extent %} <small>{{ words.extent }}</small>{% endif %}
{%- if words.machine or words.notes %}{{ marks(words) }}{% endif %}
{%- if in_paper %}<br><span class="published">{{ layout.PAPER }} {{ shown(words.published, words.published_quoted) }}
{%- if words.difference %} <span class="difference">({{ words.difference }})</span>{% endif %}</span>{% endif %}</td>
{% endmacro %}

<div class="scroll" tabindex="0" role="region" aria-label="{{ layout.TITLE }}">
<table class="results">
<caption><b>{{ layout.TITLE }}.</b> {{ table.caption|first|default("")|one_line }}</caption>
<colgroup><col></colgroup>
{% for column in table.columns %}
<colgroup span="{{ quantities|length }}"></colgroup>
{% endfor %}
<thead>
<tr>
<th scope="col" rowspan="2">method</th>
{% for column in table.columns %}
<th scope="colgroup" colspan="{{ quantities|length }}">{{ column.title|one_line }}
{%- if layout.data(column) %}<br><small>{{ layout.data(column)|one_line }}</small>{% endif %}</th>
{% endfor %}
</tr>
<tr>
{% for column in table.columns %}{% for quantity in quantities %}
<th scope="col">{{ quantity.head }} {{ quantity.unit }}</th>
{% endfor %}{% endfor %}
</tr>
</thead>
{% for rows in layout.sections(table) %}
<tbody{% if rows[0].spiking %} class="{{ layout.SPIKING }}"{% endif %}>
{% for row in rows %}
<tr>
<th scope="row">{{ row.name|one_line }}</th>
{% for column in table.columns %}{% for quantity in quantities %}
{{ cell(layout.of_cell(table, row.cells[column.name, quantity.name], quantity), layout.in_paper(row, column)) -}}
{% endfor %}{% endfor %}
</tr>
{% endfor %}
</tbody>
{% endfor %}
</table>
</div>
{% if table.caption|length > 1 %}
<p class="caption legend">{{ table.caption[1:]|join(" ")|one_line }}</p>
{% endif %}
{% if table.notes %}
<ol class="notes">
{% for note in table.notes %}
<li id="table-note-{{ loop.index }}">{{ note.text|one_line }}</li>
{% endfor %}
</ol>
{% endif %}
<ul class="machines legend">
{% for mark, machine in layout.machines(table) %}
<li id="table-machine-{{ loop.index }}">{{ mark }}: {{ machine|one_line }}</li>
{% endfor %}
</ul>
<p class="legend">{{ layout.legend(table)|join(" ") }}</p>
"""


def html(table: Table) -> str:
    """Return a table as a fragment of HTML: the table in a frame that scrolls, then notes, machines and explanations.

    Classes of cells are measured, quoted and absent; inside of them are best, published and difference. All text is
    escaped. A page has room for one such fragment: its notes have fixed anchors.
    """
    page = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page.filters["one_line"] = words.one_line
    return page.from_string(_TEMPLATE).render(table=table, layout=words, quantities=table.quantities).lstrip()
