// How many nodes have how much of something.
import { element } from './elements.js';
import { heat, MODES } from './scales.js';

const BINS = 32;
const [ WIDTH, HEIGHT ] = [ 320, 110 ];
const NAMES = { luminance: 'Light of nodes', noise: 'Noise', systematic: 'Systematic error', seen: 'Seen error of the worst places', coverage: 'Coverage', cell_size: 'Cell size' };
const svg = ( tag, properties, ...children ) => {

	const made = document.createElementNS( 'http://www.w3.org/2000/svg', tag );
	for ( const [ name, value ] of Object.entries( properties ) ) made.setAttribute( name, value );
	made.append( ...children );
	return made;

};

export async function histograms( worker, index ) {

	const made = [];
	for ( const figure of Object.keys( NAMES ) ) {

		const found = await worker( 'histogram', { index, figure, bins: BINS } );
		if ( found?.count ) made.push( histogram( figure, found ) );

	}

	return element( 'div.histograms', {}, made );

}

function histogram( figure, { from, to, counts, count } ) {

	const most = Math.max( ...counts );
	const bars = counts.map( ( n, k ) => {

		const height = n === 0 ? 0 : Math.max( 1, n / most * HEIGHT );
		const share = figure === 'coverage' ? 1 - k / ( BINS - 1 ) : k / ( BINS - 1 );
		const fill = figure === 'luminance' ? 'var(--bar)' : `rgb(${ heat( 0.15 + 0.7 * share ).map( Math.round ).join() })`;
		return svg( 'rect', { x: k * WIDTH / BINS, y: HEIGHT - height, width: WIDTH / BINS - 1, height, fill } );

	} );
	const text = figure === 'luminance' ? ( stops ) => `2^${ stops }` : MODES.find( ( { key } ) => key === figure ).text;
	return element( 'figure', {},
		element( 'figcaption', {}, element( 'b', {}, NAMES[ figure ] ), ` of ${ count.toLocaleString( 'en' ) }` ),
		svg( 'svg', { viewBox: `0 0 ${ WIDTH } ${ HEIGHT }`, role: 'img', 'aria-label': `Histogram of ${ NAMES[ figure ] }, from ${ text( from ) } to ${ text( to ) }` }, ...bars ),
		element( 'div.ends', {}, element( 'span', {}, text( from ) ), element( 'span', {}, [ 'luminance', 'coverage', 'cell_size' ].includes( figure ) ? text( to ) : `${ text( to ) } and more` ) ) );

}
