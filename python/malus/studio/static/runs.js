// The queue of runs, with progress by step and overall.
import { ask, byId, doing, duration, make, tell } from './api.js';
import { showPage } from './studio.js';
import { showReport } from './results.js';

const form = byId('start-run');
let station = null;
let timer = null;
const STATES = { waiting: 'waiting', running: 'running', done: 'done', failed: 'stopped by an error', canceled: 'canceled; it goes on where it was when it is started again' };

export async function showRuns(state) {
  station = state.station?.path ?? null;
  form.hidden = !station;
  if (station && form.dataset.station !== station) {
    form.dataset.station = station;
    form.elements.work.value = station.replace(/\.toml$/, '_work');
  }
  await refresh();
}

async function refresh() {
  clearTimeout(timer);
  const runs = await ask('runs');
  if (byId('runs').hidden) return;
  const list = byId('run-list');
  for (const run of [...runs].reverse()) {
    const old = list.querySelector(`[data-run="${run.number}"]`);
    if (!old) list.prepend(card(run));
    else update(old, run);
  }
  const order = [...list.children].sort((a, b) => b.dataset.run - a.dataset.run);
  if (order.some((element, at) => list.children[at] !== element)) list.append(...order);
  if (!runs.length) list.replaceChildren(make('p', { class: 'note' }, station ? 'Nothing has been run yet.' : 'Open a station to run it.'));
  else list.querySelector('p.note')?.remove();
  if (runs.some((run) => run.state === 'waiting' || run.state === 'running')) timer = setTimeout(() => refresh().catch(() => { timer = setTimeout(refresh, 3000); }), 700);
}

function card(run) {
  const log = make('pre', { tabindex: 0, 'aria-label': `Log of run ${run.number}` });
  const element = make('article', { class: 'run', 'data-run': run.number, 'aria-label': `Run ${run.number}` },
    make('h3', {}, `${run.station} → ${run.work}`), make('p', { 'data-state': '', role: 'status' }), make('progress', { max: 1, value: 0, 'aria-label': `Progress of run ${run.number}` }),
    make('ol'), make('p', { class: 'error', 'data-error': '' }), make('div', { class: 'row', 'data-buttons': '' }),
    make('details', { toggle: doing(async (event) => { if (event.target.open) log.textContent = (await ask('log', { number: run.number })).lines.join('\n'); }) }, make('summary', {}, 'Log'), log));
  update(element, run);
  return element;
}

function update(element, run) {
  const part = (selector) => element.querySelector(selector);
  const percent = `${Math.floor(100 * run.fraction)} %`;
  const said = run.state === 'running' ? `${percent}, ${run.step ? `${run.step}: ${run.message || '…'}, ` : ''}about ${duration(run.seconds_left ?? 0)} left` : STATES[run.state];
  if (part('[data-state]').textContent !== said) part('[data-state]').textContent = said;
  part('progress').value = run.state === 'done' ? 1 : run.fraction;
  part('ol').replaceChildren(...Object.entries(run.steps).map(([step, fraction]) => make('li', {}, `${fraction >= 1 ? '✓' : `${Math.round(100 * fraction)} %`} ${step}`)));
  part('[data-error]').textContent = run.error;
  if (element.dataset.showing === run.state) return;
  element.dataset.showing = run.state;
  const again = (text) => make('button', { type: 'button', click: doing(async () => { await tell('run', { path: run.station, work: run.work, fusion: run.fusion }); await refresh(); }) }, text);
  const buttons = { waiting: [cancel(run)], running: [cancel(run)], failed: [again('Try again')], canceled: [again('Resume')],
    done: [make('button', { type: 'button', class: 'main', click: async () => { await showPage('results'); showReport(run.work, run.report); } }, 'Show the report')] };
  part('[data-buttons]').replaceChildren(...buttons[run.state]);
}

const cancel = (run) => make('button', { type: 'button', click: doing(async () => { await tell('cancel', { number: run.number }); await refresh(); }) }, 'Cancel');

form.addEventListener('submit', doing(async () => {
  await tell('run', { path: station, work: form.elements.work.value, fusion: form.elements.fusion.value });
  await refresh();
}));
