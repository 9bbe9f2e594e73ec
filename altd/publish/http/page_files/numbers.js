// The quantities with both uncertainties.

import { html, useState } from "./vendor/htm-preact.js";
import { useKept } from "./keeping.js";
import { QUANTITIES, UNKNOWN, counted, fixed, local, sigmaOf } from "./words.js";

const FAR_DECIMALS = 1;
const POINTS = [...new Set(QUANTITIES.map(quantity => quantity.point))].filter(Boolean);

function Row({ quantity, measurement, decimals }) {
  return html`<tr>
    <th scope="row">${quantity.label}</th>
    <td class="value" id=${quantity.key}>${fixed(measurement?.[quantity.key], decimals ?? quantity.decimals)}</td>
    <td class="unit">${quantity.unit}</td>
    <td class="sigma" id=${`sigma_${quantity.key}`}>${sigmaOf(measurement, quantity)}</td>
  </tr>`;
}

// isFar: read from two metres: large, with one decimal, directions in mm/m as in the bull's eyes, one of the machine's points.
export function Numbers({ measurement, zone, isFar }) {
  const there = local(measurement?.time, zone);
  const [inSlopes, setInSlopes] = useState(isFar);
  const [point, setPoint] = useKept("point of the machine", POINTS[0] ?? "", value => POINTS.includes(value));
  const also = QUANTITIES.filter(quantity => quantity.is_also);
  const shown = QUANTITIES.filter(quantity => !quantity.is_also && !(isFar && quantity.point && quantity.point !== point) && (quantity.is_shown || measurement?.[quantity.key] != null));
  const absent = isFar ? [] : QUANTITIES.filter(quantity => !quantity.is_also && !shown.includes(quantity));
  const rows = shown.map(quantity => {
    const other = inSlopes && also.find(each => each.is_also === quantity.key);
    return html`<${Row} key=${quantity.key} quantity=${other || quantity} measurement=${measurement} decimals=${isFar && quantity.has_motion ? FAR_DECIMALS : undefined} />`;
  });
  return html`<section aria-labelledby="numbers-title" class="numbers" data-sequence=${measurement?.sequence ?? ""}>
    <h2 id="numbers-title">Measurement</h2>
    <table>
      <thead class="unseen"><tr><th scope="col">quantity</th><th scope="col">value</th><th scope="col">unit</th>
        <th scope="col">uncertainty (1 sigma)</th></tr></thead>
      <tbody>${rows}
        ${absent.map(quantity => html`<tr key=${quantity.key} class="absent"><th scope="row">${quantity.label}</th>
          <td class="value">${UNKNOWN}</td><td colspan="2" class="why">not available: ${quantity.meaning}</td></tr>`)}
      </tbody>
    </table>
    ${isFar && POINTS.length > 1 && html`<label>point of the machine <select value=${point} onChange=${event => setPoint(event.target.value)}>
      ${POINTS.map(name => html`<option key=${name} value=${name}>${name}</option>`)}</select></label>`}
    ${!isFar && html`${also.length > 0 && html`<button type="button" aria-pressed=${inSlopes} onClick=${() => setInSlopes(!inSlopes)}>
      directions in ${inSlopes ? "degrees" : also[0].unit}</button>`}
    <p class="when">${measurement ? html`<time datetime=${measurement.time}>${measurement.time ?? "time not known"}</time>${there && html` (${there.slice(11)} ${zone})`},
      number ${measurement.sequence}, mean of ${counted(measurement.frames, "exposure")}; ± is 1 sigma` : "\u00a0"}</p>`}
  </section>`;
}
