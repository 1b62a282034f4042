// The queue of runs, with progress by step and overall.
import { ask, byId, doing, duration, make, say, tell } from './api.js';
import { state } from './open_station.js';
import { showPage } from './pages.js';
import { redraw } from './redraw.js';
import { showReport } from './results.js';

const form = byId('start-run');
let timer = null;
const STATES = { waiting: 'waiting for its turn', running: 'running', done: 'done', failed: 'stopped by an error', canceled: 'canceled; Resume continues where the run stopped' };

let tickedFor;  // the station that was open when stations were ticked; when another one is opened, only that one is ticked

export async function showRuns() {
  const { stations, note } = await ask('candidates');
  if (note) say(note);
  form.hidden = !stations.length;
  const typed = Object.fromEntries(rows().map((row) => [row.dataset.station, row.querySelector('[name=work]').value]));
  const open = state.station?.path ?? stations[0];
  const kept = tickedFor === open ? new Set(chosen().map((row) => row.dataset.station)) : new Set([open]);
  tickedFor = open;
  byId('queueable').tBodies[0].replaceChildren(...stations.map((path) => make('tr', { 'data-station': path },
    make('td', {}, make('input', { type: 'checkbox', checked: kept.has(path), 'aria-label': `Run ${path}` })),
    make('th', { scope: 'row' }, path),
    make('td', {}, make('input', { name: 'work', size: 30, value: typed[path] ?? path.replace(/\.toml$/, '_work'), 'aria-label': `Results of ${path} go to` })))));
  await refresh();
}

const rows = () => [...byId('queueable').tBodies[0].rows];
const chosen = () => rows().filter((row) => row.querySelector('input[type=checkbox]').checked);

let asked = 0;
async function refresh() {
  clearTimeout(timer);
  const mine = ++asked;
  const runs = await ask('runs');
  if (mine !== asked || byId('runs').hidden) return;  // A later request has been sent, or this page is no longer shown.
  const list = byId('run-list');
  for (const run of [...runs].reverse()) {
    const old = list.querySelector(`[data-run="${run.number}"]`);
    if (!old) list.prepend(card(run));
    else update(old, run);
  }
  const known = new Set(runs.map((run) => String(run.number)));
  for (const old of list.querySelectorAll('[data-run]')) if (!known.has(old.dataset.run)) old.remove();
  const order = [...list.children].sort((a, b) => b.dataset.run - a.dataset.run);
  if (order.some((element, at) => list.children[at] !== element)) list.append(...order);
  if (!runs.length) list.replaceChildren(make('p', { class: 'note' }, form.hidden ? 'There is no station in the opened folder yet; make one under Images.' : 'Nothing has been run since Studio was opened; earlier results stand under Results.'));
  else list.querySelector('p.note')?.remove();
  await Promise.all([...list.querySelectorAll('[data-run]')].map(showLog));
  if (runs.some((run) => run.state === 'waiting' || run.state === 'running')) timer = later(700);
}

// Refreshes after a delay, and keeps trying if Studio does not answer; the error is shown.
function later(ms) {
  timer = setTimeout(async () => {
    try {
      await refresh();
    } catch (error) {
      say(error.message);
      later(3000);
    }
  }, ms);
}

function card(run) {
  const element = make('article', { class: 'run', 'data-run': run.number, 'aria-label': `Run ${run.number}` },
    make('h3', {}, run.title), make('p', { 'data-state': '', role: 'status' }), make('progress', { max: 1, value: 0, 'aria-label': `Progress of run ${run.number}` }),
    make('ol'), make('p', { class: 'error', 'data-error': '' }), make('div', { class: 'row', 'data-buttons': '' }),
    make('details', { toggle: doing(() => showLog(element)) }, make('summary', {}, 'Log'), make('pre', { tabindex: 0, 'aria-label': `Log of run ${run.number}` })));
  update(element, run);
  return element;
}

// Updates the log of a run if it is unfolded. It keeps showing the newest line, unless the user has scrolled up.
async function showLog(element) {
  if (!element.querySelector('details').open) return;
  const log = element.querySelector('pre');
  const { lines } = await ask('log', { number: element.dataset.run });
  const atEnd = log.scrollTop + log.clientHeight >= log.scrollHeight - 4;
  const text = lines.join('\n');
  if (log.textContent === text) return;
  log.textContent = text;
  if (atEnd) log.scrollTop = log.scrollHeight;
}

function update(element, run) {
  const part = (selector) => element.querySelector(selector);
  const percent = `${Math.floor(100 * run.fraction)} %`;
  const said = run.state === 'running' ? `${percent}, ${run.step ? `${run.step}: ${run.message || '…'}, ` : ''}${run.seconds_left === null ? 'starting' : `about ${duration(run.seconds_left)} left`}` : STATES[run.state];
  if (part('[data-state]').textContent !== said) part('[data-state]').textContent = said;
  part('progress').value = run.state === 'done' ? 1 : run.fraction;
  part('ol').replaceChildren(...Object.entries(run.steps).map(([step, fraction]) => make('li', {}, `${fraction >= 1 ? '✓' : `${Math.round(100 * fraction)} %`} ${step}`)));
  part('[data-error]').textContent = run.error;
  if (element.dataset.showing === run.state) return;
  element.dataset.showing = run.state;
  const again = (text) => make('button', { type: 'button', click: doing(() => startAgain(run)) }, text);
  const buttons = { waiting: [cancel(run)], running: [cancel(run)], failed: [again('Try again')], canceled: [again('Resume')],
    done: [make('button', { type: 'button', class: 'main', click: async () => { await showPage('results'); showReport(run.work, run.report); } }, 'Show the report')] };
  redraw(part('[data-buttons]'), ...buttons[run.state]);
}

// Starts a run again as a new run, and moves the keyboard focus to it.
async function startAgain(run) {
  const { number } = await tell(run.asked.name, run.asked.body);
  const first = () => byId('run-list').querySelector(`[data-run="${number}"] button`);
  // A refresh that a later one has overtaken draws nothing.
  for (let tries = 0; tries === 0 || (!first() && tries < 10); ++tries) await refresh();
  first()?.focus();
}

const cancel = (run) => make('button', { type: 'button', click: doing(async () => { await tell('cancel', { number: run.number }); await refresh(); }) }, 'Cancel');

form.addEventListener('submit', doing(async () => {
  if (!chosen().length) throw new Error('Tick the stations to run.');
  try {
    for (const row of chosen()) await tell('run', { path: row.dataset.station, work: row.querySelector('[name=work]').value, fusion: form.elements.fusion.value });
  } finally {
    await refresh();
  }
}));
